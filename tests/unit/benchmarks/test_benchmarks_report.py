"""What the benchmarks make of their numbers: intervals, slopes, tables, plots, and which results are fresh."""

import ast
import json
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest

from benchmarks import report
from benchmarks.run import PROGRAMS


def test_the_interval_covers_the_true_mean_in_about_95_of_100_samples():
    rng = np.random.default_rng(3)
    hits = [low <= 1 <= high for _, low, high in (
        report.mean_interval(rng.exponential(size=120), draws=400, seed=i) for i in range(300))]  # fmt: skip
    assert 0.89 < np.mean(hits) < 0.98


def test_a_power_law_has_its_exponent():
    x = np.array([1.0, 3, 10, 50])
    assert report.slope(x, 7 * x**1.3) == pytest.approx(1.3)


@pytest.mark.parametrize(
    ("value", "text"),
    [(0, "0"), (1234.5, "1234"), (12.345, "12.3"), (0.01234, "0.0123"), (0.000012, "1e-5"), (3e7, "3e7"), (None, "–"),
     (float("nan"), "–")],
)  # fmt: skip
def test_numbers_keep_three_digits(value, text):
    assert report.short(value) == text


def test_a_table_is_markdown():
    assert report.table(["a", "b"], [[1, "x"]]) == ["| a | b |", "|---|---|", "| 1 | x |", ""]


def test_quartiles_are_taken_over_runs():
    folded = report.fold([np.array([1.0, 10]), np.array([2.0, 20]), np.array([3.0, 30])])
    assert folded == {"low": [1.5, 15], "median": [2, 20], "high": [2.5, 25]}


def test_a_plot_is_a_small_picture_that_can_be_read(tmp_path):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed: it is for benchmarks alone")
    with report.plot(tmp_path, "line", "A title") as axes:
        axes[0][0].plot([1, 1000], [1, 10])
        axes[0][0].set(xscale="log", yscale="log")
    root = ElementTree.parse(tmp_path / "line.svg").getroot()
    assert root.tag.endswith("svg") and "A title" in "".join(root.itertext())
    assert (tmp_path / "line.svg").stat().st_size < report.MAX_BYTES


def test_lines_of_a_plot_are_relative_and_end_where_they_did():
    path = "M40.1 189.5 L40.1 33.6 L40.6 33.5 L1008 0 z M0 2.5 L-1 3 M1 2 C1 2 3 4 5 6"
    assert report.relative_lines(path) == "M40.1 189.5l0-155.9 .5-.1 967.4-33.5 z M0 2.5l-1 .5 M1 2 C1 2 3 4 5 6"


@pytest.fixture
def program(tmp_path, monkeypatch):
    """A benchmark that counts how often it measures; what it depends on is a file."""
    source = tmp_path / "source.py"
    source.write_text("1")
    monkeypatch.setattr(report, "_SOURCES", ())
    monkeypatch.setattr(report, "machine", lambda: {"processor": "a machine"})
    calls = []

    def measure(quick):
        calls.append(quick)
        return {"value": len(calls)}

    made = report.Program("one", "One", str(source), measure, lambda d, _: [f"value {d['value']}"], lambda d: "")
    folders = ["--output", str(tmp_path / "pages"), "--cache", str(tmp_path / "cache")]

    def run(*flags):
        report.run(made, [*folders, *flags])
        return (tmp_path / "pages" / "one.md").read_text()

    return run, calls, source


def test_a_fresh_result_is_not_measured_again(program):
    run, calls, source = program
    assert "value 1" in run() and "value 1" in run()
    assert calls == [False]
    source.write_text("2")
    assert "value 2" in run() and "value 3" in run("--again")


def test_quick_results_are_kept_apart_and_say_so(program, tmp_path):
    run, calls, _ = program
    run()
    assert "the numbers mean nothing" in run("--quick") and calls == [False, True]
    assert "mean nothing" not in run()
    assert json.loads((tmp_path / "cache" / "one.json").read_text())["data"] == {"value": 1}


def test_every_program_with_a_result_is_run_by_make_bench():
    run = pytest.importorskip("benchmarks.run", reason="scipy or bpy is not installed")
    folder = Path(report.__file__).parent
    written = {path.name for path in folder.glob("*.py") if "\nPROGRAM = " in path.read_text(encoding="utf-8")}
    assert {Path(program.PROGRAM.source).name for program in run.PROGRAMS.values()} == written


def imported_files(path):
    """Files of the program and its benchmarks that a module imports, anywhere in it."""
    package = path.relative_to(report.ROOT).parts
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import | ast.ImportFrom) else []
        if isinstance(node, ast.ImportFrom):
            module = [*package[: -node.level if node.level else 0], *filter(None, [node.module])]
            names = [".".join(module), *(".".join([*module, name]) for name in names)]
        for name in names:
            place = report.ROOT.joinpath(*name.split("."))
            if name.startswith(("benchmarks.", "irpso_addon.")):
                yield from (file for file in (place.with_suffix(".py"), place / "__init__.py") if file.is_file())


@pytest.mark.parametrize("name", PROGRAMS)
def test_a_result_depends_on_all_that_its_program_imports(name):
    program = PROGRAMS[name].PROGRAM
    known, seen, todo = set(report.source_files(program)), set(), [Path(program.source)]
    while todo:
        path = todo.pop()
        new = set(imported_files(path)) - seen - {Path(report.__file__), report.ROOT / "benchmarks" / "__init__.py"}
        assert not (unknown := sorted(file.as_posix() for file in new - known)), f"{path.name} imports {unknown}"
        seen |= new
        todo += [file for file in new if "benchmarks" in file.parts]
