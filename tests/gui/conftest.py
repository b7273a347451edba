"""Tests in a real Blender window; `make test-gui` runs them (see README.md in this folder)."""

import os
import re
import shutil
import sys
from contextlib import suppress
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "scripts"))

from blender_window import Blender, BlenderGone, Window, build_package, find_blender, install, open_window  # noqa: E402


@pytest.fixture(scope="session")
def backend() -> str:
    """The GPU backend that Blender is started with: opengl or vulkan."""
    return os.environ.get("BLENDER_BACKEND") or "opengl"


@pytest.fixture(scope="session")
def blender() -> Blender:
    """The Blender that is tested."""
    try:
        return find_blender()
    except SystemExit as refusal:
        pytest.exit(str(refusal), 2)


@pytest.fixture(scope="session")
def installed(blender, tmp_path_factory) -> Path:
    """Blender's settings and extensions, with the built zip installed and enabled and nothing else; only to be copied.

    run_gui.py installs once for all modules and hands the folder over.
    """
    if folder := os.environ.get("IRPSO_INSTALLED"):
        return Path(folder)
    own = tmp_path_factory.mktemp("installed")
    install(blender, build_package(own / "dist"), own / "user")
    return own / "user"


@pytest.fixture(scope="session")
def pictures(blender, backend) -> Path:
    """The folder of the screenshots; emptied by run_gui.py, never committed."""
    return ROOT / ".cache" / "gui" / f"{blender.name}-{backend}"


@pytest.fixture(scope="module")
def window(request, blender, installed, pictures, backend) -> Window:
    """A Blender window of the test module's own, with the extension enabled and the default scene in it."""
    with open_window(blender, installed, pictures, backend, log_name=Path(request.path).stem) as opened:
        yield opened


@pytest.fixture
def settings(installed, tmp_path) -> Path:
    """A copy of ``installed`` for a Blender that a test starts itself."""
    return Path(shutil.copytree(installed, tmp_path / "user"))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    report = yield
    item.stash.setdefault(FAILED, []).append(report.failed)
    return report


FAILED = pytest.StashKey[list]()


@pytest.fixture(autouse=True)
def without_complaint(request):
    """Fail a test during which Blender said that something was wrong; take a picture where a test failed."""
    yield
    if "window" not in request.fixturenames or "window" not in request.node.funcargs:
        return
    window = request.node.funcargs["window"]
    complaints = window.complaints()
    if complaints or any(request.node.stash.get(FAILED, [])):
        with suppress(BlenderGone):
            window.screenshot(f"FAILED-{request.node.name}")
    for line in complaints:
        window.expect(re.escape(line))  # said here once, not again by every test that follows
    assert not complaints, f"Blender complained:\n{window.log()[-4000:]}"
