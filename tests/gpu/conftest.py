"""Tests in headless Blender: one process a module, ended by force once pytest has said all it has to say."""

import functools
import os
import sys
from contextlib import closing

import pytest

NO_GPU = os.environ.get("IRPSO_NO_GPU")  # the reason, found by tests/run.py in a process of its own
_exit_status = pytest.StashKey[int]()


def pytest_collection_modifyitems(config, items):
    here = [item for item in items if config.rootpath / "tests" / "gpu" in item.path.parents]
    modules = {item.path.name for item in here}
    if len(modules) > 1 and not config.option.collectonly:
        # A shared process was seen to invent failures: GPU objects and scenes of one module reach into the next.
        raise pytest.UsageError("each module of tests/gpu needs its own process: use tests/run.py, or name one module")
    if NO_GPU:
        for item in here:
            if not item.get_closest_marker("bpy_only"):
                item.add_marker(pytest.mark.skip(reason=NO_GPU))


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session, exitstatus):
    session.config.stash[_exit_status] = int(exitstatus)


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config):
    # bpy 4.5 never exits by itself and 4.2 may crash while it does, long after the tests have passed.
    if "bpy" in sys.modules and _exit_status in config.stash:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(config.stash[_exit_status])


@pytest.fixture(scope="module", autouse=True)
def few_samplers():
    """Let every pass be refused that reads more than 16 textures, as on the GPUs that have no more units."""
    from irpso_addon.gpu import context

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(context, "max_samplers", lambda: 16)
        yield


@pytest.fixture(scope="module", autouse=True)
def made_once(request):
    """Compile a kernel and probe the GPU once in this process: without a GPU both take longer than most tests."""
    if request.path.parent.name == "gpu":  # the room whose tests are about just that
        yield
        return
    from irpso_addon.gpu import probe
    from irpso_addon.gpu.program import ProgramCache

    with pytest.MonkeyPatch.context() as patch, closing(ProgramCache()):
        patch.setattr(probe, "probe", functools.cache(probe.probe))
        yield


@pytest.fixture(scope="module")
def gpu():
    """Make the GPU context."""
    from irpso_addon.gpu import context

    context.ensure()


@pytest.fixture(scope="module")
def registered():
    """Have the extension registered."""
    import irpso_addon

    irpso_addon.register()
    yield
    irpso_addon.unregister()
