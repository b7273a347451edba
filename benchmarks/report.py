"""Runs benchmarks and writes their result files and pages: tables, plots, the machine, confidence intervals."""

from __future__ import annotations

import argparse
import datetime
import hashlib
import json
import os
import platform
import re
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
PAGES = ROOT / "docs" / "benchmarks"
CACHE = ROOT / ".cache" / "bench"
QUICK_PAGES = CACHE / "quick-pages"  # a smoke run must not replace measured pages
MAX_BYTES = 60_000  # of a plot
# Okabe & Ito 2008, distinct under colour blindness. Black is the program itself.
COLORS = ("#000000", "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8c8c8c")
# Sources that every result depends on, besides its program's.
_SOURCES = ("presets/*.toml", "shaders/**/*.*", "irpso_addon/solver/**/*.py", "benchmarks/subjects.py",
            "benchmarks/product.py", "benchmarks/peers/*.py")  # fmt: skip


@dataclass(frozen=True)
class Program:
    """A benchmark. measure(quick) → data for JSON; write(data, folder) writes plots and returns the page's lines.

    name: of page and result file. source: the module's file. title: of the page. headline(data): for the index.
    """

    name: str
    title: str
    source: str
    measure: Callable[[bool], dict[str, Any]]
    write: Callable[[dict[str, Any], Path], list[str]]
    headline: Callable[[dict[str, Any]], str]


def result_path(program: Program, quick: bool, cache: Path = CACHE) -> Path:
    """Return the path of a program's result file."""
    return cache / f"{program.name}{'-quick' if quick else ''}.json"


def run(program: Program, arguments: Sequence[str] | None = None) -> None:
    """Measure, unless there is a fresh result, store the result, and write the page: every program's command line.

    A result is fresh if it was measured in the same mode (--quick or not) with the same sources and presets.
    """
    parser = argparse.ArgumentParser(description=program.title)
    parser.add_argument("--quick", action="store_true", help="tiny sizes, to see that it runs")
    parser.add_argument("--again", action="store_true", help="measure even where there is a fresh result")
    parser.add_argument("--draw", action="store_true", help="write the page of the result there is, fresh or not")
    parser.add_argument("--output", type=Path, help="folder of pages and plots (default: docs/benchmarks)")
    parser.add_argument("--cache", type=Path, default=CACHE, help="folder of result files")
    options = parser.parse_args(arguments)
    output = options.output or (QUICK_PAGES if options.quick else PAGES)
    path = result_path(program, options.quick, options.cache)
    result = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else None
    current_digest = digest(program.source)
    if options.draw and result is None:
        parser.error(f"{path} is not there; measure first")
    if output.exists() and not output.is_dir():
        parser.error(f"--output {output}: is a file; give a folder")
    if not options.draw and (options.again or result is None or result["digest"] != current_digest):
        load, start = os.getloadavg()[0], time.perf_counter()
        data = program.measure(options.quick)
        result = {
            "name": program.name, "title": program.title, "quick": options.quick, "digest": current_digest,
            "date": datetime.date.today().isoformat(), "machine": machine(), "commit": commit(),
            "load": [round(load, 1), round(os.getloadavg()[0], 1)],
            "seconds": round(time.perf_counter() - start, 1), "data": data,
        }  # fmt: skip
        options.cache.mkdir(parents=True, exist_ok=True)
        partial = path.with_suffix(".partial")
        partial.write_text(json.dumps(result, indent=1), encoding="utf-8")
        partial.replace(path)
    output.mkdir(parents=True, exist_ok=True)
    tried = ["**A smoke run with tiny sizes: the numbers mean nothing.**", ""] if result["quick"] else []
    lines = [f"# {program.title}", "", *tried, *program.write(result["data"], output), "", *_foot(result, program)]
    (output / f"{program.name}.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    say(f"{program.name}: {output / (program.name + '.md')}")


def _foot(result: dict[str, Any], program: Program) -> list[str]:
    return [
        f"<sub>`python -m benchmarks.{Path(program.source).stem}`, {result['date']}, commit {result['commit']},"
        f" {result['seconds']:.0f} s; {'; '.join(result['machine'].values())}; load of the machine"
        f" {result['load'][0]} before and {result['load'][1]} after.</sub>"
    ]


def digest(source: str) -> str:
    """Return a digest of the sources that a result depends on."""
    sha256 = hashlib.sha256()
    for path in [Path(source), *(p for pattern in _SOURCES for p in sorted(ROOT.glob(pattern)) if p.is_file())]:
        sha256.update(path.read_bytes())
    return sha256.hexdigest()[:16]


def machine() -> dict[str, str]:
    """Return the machine's processor, memory, renderer and software, as texts."""
    import bpy

    from irpso_addon.gpu import context

    cpuinfo = Path("/proc/cpuinfo")
    names = re.findall(r"model name\s*:\s*(.*)", cpuinfo.read_text()) if cpuinfo.is_file() else []
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30 if hasattr(os, "sysconf") else 0
    return {
        "processor": f"{names[0] if names else platform.machine()}, {os.cpu_count()} cores",
        "memory": f"{memory:.0f} GiB",
        "renderer": str(context.describe()["renderer"]),
        "software": f"Blender {bpy.app.version_string}, Python {platform.python_version()}, {platform.system()}",
    }


def commit() -> str:
    """Return the checked-out commit, with "+" if the program has uncommitted changes."""
    head = _git("rev-parse", "--short", "HEAD")
    changed = _git("status", "--porcelain", "--untracked-files=no", "irpso_addon", "shaders", "presets", "benchmarks")
    return f"{head or 'unknown'}{'+' if changed else ''}"


def _git(*arguments: str) -> str:
    process = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True)
    return process.stdout.strip() if process.returncode == 0 else ""


def say(text: str) -> None:
    """Print a line of progress to stderr."""
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()


# ---- numbers -----------------------------------------------------------------------------------------------------


def short(value: float | None, digits: int = 3) -> str:
    """Return a number with ``digits`` significant digits; an en dash for none."""
    if value is None or not np.isfinite(value):
        return "–"
    if value == 0:
        return "0"
    if not 1e-3 <= abs(value) < 1e6:
        return f"{value:.0e}".replace("e-0", "e-").replace("e+0", "e")
    places = digits - 1 - int(np.floor(np.log10(abs(value))))
    return f"{value:.{max(places, 0)}f}"


def mean_interval(values: np.ndarray, draws: int = 2000, seed: int = 0) -> tuple[float, float, float]:
    """Return the mean of (T,) values and its 95 % confidence interval, by the bootstrap (Efron 1979)."""
    values = np.asarray(values, np.float64)
    rng = np.random.default_rng(seed)
    means = np.empty(draws)
    for i in range(draws):
        means[i] = values[rng.integers(len(values), size=len(values))].mean()
    return float(values.mean()), *(float(q) for q in np.quantile(means, (0.025, 0.975)))


def slope(x: Sequence[float], y: Sequence[float]) -> float:
    """Return the exponent of y ∝ xⁿ, by least squares in the logarithms."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def fold(values: Iterable[np.ndarray]) -> dict[str, list[float]]:
    """Return median and quartiles over the first axis of equally long rows, as JSON holds them."""
    rows = np.array(list(values), np.float64)
    return {name: np.quantile(rows, q, axis=0).tolist() for name, q in (("low", 0.25), ("median", 0.5), ("high", 0.75))}


# ---- pages -------------------------------------------------------------------------------------------------------


def table(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> list[str]:
    """Return the lines of a Markdown table, and an empty one."""
    lines = [f"| {' | '.join(header)} |", f"|{'---|' * len(header)}"]
    return [*lines, *(f"| {' | '.join(str(cell) for cell in row)} |" for row in rows), ""]


@contextmanager
def plot(folder: Path, name: str, title: str, columns: int = 1, rows: int = 1, **settings) -> Iterator[Any]:
    """Yield axes (rows, columns) to draw on; write the figure to the folder at the end. ``image`` shows it on a page.

    settings: of matplotlib's subplots.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    # Text as text in one font: files are small and searchable.
    style = {
        "svg.fonttype": "none", "svg.hashsalt": name, "font.size": 9, "axes.spines.top": False,
        "axes.spines.right": False, "axes.grid": True, "grid.color": "#e4e4e4", "grid.linewidth": 0.6,
        "axes.axisbelow": True, "legend.frameon": False, "figure.dpi": 110, "axes.titlesize": 10,
        "xtick.bottom": False, "ytick.left": False, "font.family": "sans-serif", "font.sans-serif": ["DejaVu Sans"],
    }  # fmt: skip
    with plt.rc_context(style):
        size = settings.pop("figsize", (4.2 * columns, 3.1 * rows + 0.3))
        figure, axes = plt.subplots(rows, columns, figsize=size, squeeze=False, layout="constrained", **settings)
        figure.suptitle(title, fontsize=11)
        yield axes
        for axis in axes.flat:
            for one in (axis.xaxis, axis.yaxis):
                _few_ticks(one)
        path = folder / f"{name}.svg"
        figure.savefig(path, metadata={"Date": None})
        plt.close(figure)
        path.write_text(_minified(path.read_text(encoding="utf-8")), encoding="utf-8")
        if path.stat().st_size > MAX_BYTES:
            raise ValueError(f"{path}: {path.stat().st_size} bytes are too many for a plot; draw less")


def _few_ticks(axis: Any) -> None:
    """Set a logarithmic axis's ticks at decades, or at 1, 2 and 5 if it has few decades."""
    from matplotlib.ticker import FixedLocator, FormatStrFormatter, LogLocator, NullLocator

    axis.set_minor_locator(NullLocator())
    if axis.get_scale() != "log" or isinstance(axis.get_major_locator(), FixedLocator):
        return
    low, high = sorted(axis.get_view_interval())
    if high / low < 30:
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high / low > 5 else (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)))
        axis.set_major_formatter(FormatStrFormatter("%g"))


def _without_bare_groups(svg: str) -> str:
    """Return a picture without groups that have no attributes."""
    has_attributes: list[bool] = []  # of each open group

    def tag(match: re.Match[str]) -> str:
        if match[0] != "</g>":
            has_attributes.append(match[0] != "<g>")
            return match[0] if has_attributes[-1] else ""
        return match[0] if has_attributes.pop() else ""

    return re.sub(r"<g>|<g [^>]*[^/>]>|</g>", tag, svg)


def _with_classes(svg: str) -> str:
    """Return a picture whose repeated styles are classes."""
    counts = Counter(re.findall(r' style="([^"]*)"', svg))
    names = {style: f"s{number}" for number, (style, count) in enumerate(counts.most_common()) if count > 2}
    svg = re.sub(
        r' style="([^"]*)"', lambda match: f' class="{names[match[1]]}"' if match[1] in names else match[0], svg
    )
    rules = "".join(f".{name}{{{style}}}" for style, name in names.items())
    return svg.replace("</style>", f"{rules}</style>", 1)


_FONT = "font-family: 'DejaVu Sans'"  # of all text
_ID = re.compile(r"\b[mp][0-9a-f]{10}\b")  # matplotlib's names of markers and clip paths


def _minified(svg: str) -> str:
    """Return an SVG without comments, long names, blanks, and digits below a tenth; with one font for all text."""
    svg = re.sub(r"<!--.*?-->", "", svg, flags=re.DOTALL)
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r"<!DOCTYPE[^>]*>", "", svg)
    ids = {name: f"i{number}" for number, name in enumerate(dict.fromkeys(re.findall(_ID, svg)))}
    svg = re.sub(_ID, lambda match: ids[match[0]], svg)
    svg = re.sub(r"(\d+\.\d)\d+", r"\1", svg)
    svg = _without_bare_groups(re.sub(r'<g id="[^"]*">', "<g>", svg))
    svg = re.sub(rf";? *{_FONT}(, sans-serif)?", "", svg).replace("</style>", f"text{{{_FONT}, sans-serif}}</style>")
    svg = re.sub(r'(?<= )style="[^"]*"', lambda match: re.sub(r"([:;]) ", r"\1", match[0]), svg)
    svg = re.sub(r'(?<= )d="[^"]*"', lambda match: re.sub(r" ?([A-Zz\"]) ?", r"\1", match[0]), svg)
    svg = re.sub(r'(?<= )(?:d|transform)="[^"]*"', lambda match: re.sub(r"(\d)\.0\b", r"\1", match[0]), svg)
    svg = _with_classes(re.sub(r"\s*\n\s*", " ", svg))
    return re.sub(r"> <", ">\n<", svg).replace(" </", "</").replace('" />', '"/>') + "\n"


def image(name: str, text: str) -> list[str]:
    """Return the lines that show a plot on a page."""
    return [f"![{text}]({name}.svg)", ""]
