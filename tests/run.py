"""Runs the tests: the unit tests in one process, beside it every module of tests/gpu in a Blender process of its own.

Usage: python tests/run.py [FILE_OR_FOLDER…] [--jobs 2] [--timeout 1800] [-- ARGUMENTS FOR PYTEST]
The last line is `N passed, N failed, N skipped`; the exit code is 1 if anything failed. IRPSO_REQUIRE_GPU=1 turns a
missing GPU context from a reason to skip into a failure. A process that a signal ends runs once more, and a line AGAIN
names the test: llvmpipe with threads of its own sometimes damages the heap (docs/install.md).
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

# Of tests/gpu, those that begin first because they take longest.
SLOW = (
    "test_tiled", "test_cli_rerun", "test_cli_recover", "test_cli_mesh", "test_mpirun", "test_ui_doors",
    "test_ui_hold_out",
)  # fmt: skip

TESTS = Path(__file__).resolve().parent
ROOT = TESTS.parent

# Makes a context in the two ways there are, without a line of the program under test: a machine that has a GPU but on
# which the program cannot use it must fail, not skip. 5.2 has gpu.init(); before it, a render engine is lent one.
PROBE = """
import os, sys
import bpy, gpu
if hasattr(gpu, "init"):
    gpu.init()
    print("IRPSO-GPU", gpu.platform.renderer_get(), flush=True)
else:
    class Probe(bpy.types.RenderEngine):
        bl_idname, bl_label, bl_use_gpu_context = "IRPSO_TEST_PROBE", "Probe", True
        def render(self, depsgraph):
            print("IRPSO-GPU", gpu.platform.renderer_get(), flush=True)
    bpy.utils.register_class(Probe)
    scene = bpy.context.scene
    scene.render.engine = Probe.bl_idname
    scene.render.resolution_x = scene.render.resolution_y = 8
    bpy.ops.render.render()
os._exit(0)
"""


@dataclass
class Result:
    """What became of one process of tests."""

    name: str
    passed: int = 0
    failed: list[str] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)
    output: str = ""
    crash: str = ""  # of the first process: its test and signal
    seconds: float = 0.0


def run_process(command: list[str], timeout: float, environment: dict[str, str]) -> tuple[int | None, str]:
    """Run a command; return its exit code (None when it was stopped at the timeout) and all that it printed."""
    with tempfile.TemporaryFile() as sink:
        process = subprocess.Popen(
            command, cwd=ROOT, env=environment, stdin=subprocess.DEVNULL, stdout=sink, stderr=subprocess.STDOUT,
            start_new_session=True,
        )  # fmt: skip
        try:
            code = process.wait(timeout)
        except subprocess.TimeoutExpired:
            code = None
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        sink.seek(0)
        return code, sink.read().decode(errors="replace")


def probe_gpu() -> str:
    """Return "" when this machine can give Blender a GPU context, otherwise the reason why not."""
    code, output = run_process([sys.executable, "-c", PROBE], 120, dict(os.environ))
    found = [line for line in output.splitlines() if line.startswith("IRPSO-GPU ")]
    if found:
        print(f"GPU: {found[0].removeprefix('IRPSO-GPU ')}", flush=True)
        return ""
    last = (output.strip().splitlines() or ["no output"])[-1]
    return f"no GPU context: the probe {'timed out' if code is None else f'ended with {code}'} ({last})"


def run_pytest(target: Path, timeout: float, arguments: list[str], no_gpu: str, crash: str = "") -> Result:
    """Run pytest on one file or folder in its own process and read what it recorded, however the process ended.

    crash: of a process before this one; without it, one that a signal ends is followed by another.
    """
    name = str(target.relative_to(ROOT))
    result, started = Result(name, crash=crash), time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        record = Path(folder) / "record"
        environment = {**os.environ, "IRPSO_TEST_RECORD": str(record), "IRPSO_NO_GPU": no_gpu}
        command = [sys.executable, "-X", "faulthandler", "-m", "pytest", "-q", str(target), *arguments]
        code, result.output = run_process(command, timeout, environment)
        lines = [json.loads(line) for line in record.read_text().splitlines()] if record.exists() else []
    result.seconds = time.monotonic() - started
    read_record(result, lines)
    nothing_matched = code == 5 and bool(arguments) and not lines
    unfinished = unfinished_tests(lines)
    if unfinished or (code != 0 and not result.failed and not nothing_matched):
        ending = f"stopped after {timeout:.0f} s" if code is None else f"process ended with {code}"
        result.failed.append(f"{(unfinished or [name])[0]} ({ending})")
    if code is not None and code < 0 and not crash:
        return run_pytest(target, timeout, arguments, no_gpu, result.failed[-1])
    return result


def unfinished_tests(lines: list[dict[str, str]]) -> list[str]:
    """Return the tests of a record that began and did not end, because the process did."""
    finished = {line["test"] for line in lines if line["event"] == "finish"}
    return [line["test"] for line in lines if line["event"] == "start" and line["test"] not in finished]


def read_record(result: Result, lines: list[dict[str, str]]) -> None:
    """Count the outcomes of a record; a test that fails and then fails again while cleaning up counts once."""
    for line in lines:
        if line["event"] == "passed":
            result.passed += 1
        elif line["event"] == "failed" and line["test"] not in result.failed:
            result.failed.append(line["test"])
        elif line["event"] == "skipped":
            result.skipped.append(f"{line['test']}: {line['reason'].removeprefix('Skipped: ')}")


def targets_of(paths: list[Path]) -> list[Path]:
    """Return what runs in a process each, what takes longest first: files of the unit tests, modules of tests/gpu."""
    unit, gpu = [], []
    for path in paths or [TESTS / "unit", TESTS / "gpu"]:
        path = path.resolve()
        if TESTS / "gpu" in (path, *path.parents):
            gpu += path.rglob("test_*.py") if path.is_dir() else [path]
        else:
            unit.append(path)
    return unit + sorted(gpu, key=lambda path: (path.stem not in SLOW, path))


def report(result: Result) -> None:
    """Print one line for a process, and all of its output where something failed."""
    counts = f"{result.passed} passed, {len(result.failed)} failed, {len(result.skipped)} skipped"
    if result.failed:
        print(result.output.rstrip(), flush=True)
    if result.crash:
        print(f"again: {result.crash}", flush=True)
    print(f"{'FAIL' if result.failed else 'ok':4} {result.name}: {counts} ({result.seconds:.0f} s)", flush=True)


def main() -> int:
    """Run everything asked for; return 1 if anything failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", nargs="*", type=Path)
    parser.add_argument("--jobs", type=int, default=2, help="Blender processes at a time")
    parser.add_argument("--timeout", type=float, default=1800, help="seconds for one process")
    cut = sys.argv.index("--") if "--" in sys.argv else len(sys.argv)
    options, rest = parser.parse_args(sys.argv[1:cut]), sys.argv[cut + 1 :]

    targets, results = targets_of(options.paths), []
    no_gpu = probe_gpu() if any(TESTS / "gpu" in target.parents for target in targets) else ""
    if no_gpu and os.environ.get("IRPSO_REQUIRE_GPU"):
        results.append(Result("GPU probe", failed=[no_gpu]))
    results += run_all(targets, options.jobs, options.timeout, rest, no_gpu)
    return summarize(results)


def run_all(targets: list[Path], jobs: int, timeout: float, arguments: list[str], no_gpu: str = "") -> list[Result]:
    """Run pytest on every target, ``jobs`` at a time, and print a line for each; return what became of them."""
    # No threads of llvmpipe: a race between them damages the heap (docs/install.md), and small draws wait for them.
    os.environ.setdefault("LP_NUM_THREADS", "0")
    # As many processes run as there are cores: OpenBLAS's threads would wait for one another, even over 3×3 matrices.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    results = []
    with ThreadPoolExecutor(jobs) as pool:
        for result in pool.map(lambda target: run_pytest(target, timeout, arguments, no_gpu), targets):
            results.append(result)
            report(result)
    return results


def summarize(results: list[Result]) -> int:
    """Print what was skipped, run again or failed, and the counts; return 1 if anything failed."""
    failed = [test for result in results for test in result.failed]
    skipped = [test for result in results for test in result.skipped]
    for test in skipped:
        print(f"SKIPPED {test}")
    for result in results:
        if result.crash:
            print(f"AGAIN {result.crash}")
    for test in failed:
        print(f"FAILED {test}")
    print(f"{sum(result.passed for result in results)} passed, {len(failed)} failed, {len(skipped)} skipped")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
