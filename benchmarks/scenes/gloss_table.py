"""Tables of the results of benchmarks/gloss.py: of one run, or of several side by side."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

Row = dict[str, Any]

# key of a row: (heading, decimals). A row is a card and a capture; None where a card has no such texels.
COLUMNS = {
    "normal_mean": ("normal ° mean", 2),
    "normal_median": ("median", 2),
    "base_color": ("base colour", 4),
    "base_color_metal": ("of metals", 4),
    "metallic": ("metallic", 3),
    "roughness_glossy": ("roughness < .2 mean", 3),
    "roughness_glossy_median": ("median", 3),
    "roughness_matt": ("roughness ≥ .2 mean", 3),
    "roughness_matt_median": ("median", 3),
    "psnr": ("PSNR dB", 1),
    "psnr_highlights": ("of highlights", 1),
    "seconds": ("s", 0),
}
# Columns that compare several runs: with all of them a table is too wide to read.
COMPARED = {
    "normal_mean": "normal °",
    "base_color": "base colour",
    "base_color_metal": "of metals",
    "metallic": "metallic",
    "roughness_glossy": "roughness < .2",
    "roughness_matt": "≥ .2",
    "psnr": "PSNR dB",
    "psnr_highlights": "of highlights",
    "seconds": "s",
}


# Column of each map: per cent of the texels whose error exceeds three deviations.
BEYOND = {f"beyond_{name}": name for name in ("normal", "base_color", "metallic", "roughness")}


def coverage(rows: Sequence[Row]) -> str:
    """Return the markdown table of the texels with errors above three of their deviations, in per cent."""
    lines = [_line(["card", "capture", *(f"{name} > 3 σ, %" for name in BEYOND.values())])]
    lines.append("|---" * (len(BEYOND) + 2) + "|")
    for row in rows:
        shares = ("–" if row.get(key) is None else f"{100 * row[key]:.1f}" for key in BEYOND)
        lines.append(_line([row["card"], row["capture"], *shares]))
    return "\n".join(lines)


def one_run(rows: Sequence[Row]) -> str:
    """Return the markdown table of rows, one a card and capture."""
    lines = [_line(["card", "capture", "label", *(heading for heading, _ in COLUMNS.values())])]
    lines.append("|---" * (len(COLUMNS) + 3) + "|")
    for row in rows:
        lines.append(_line([row["card"], row["capture"], row["label"], *(_number(row, key) for key in COLUMNS)]))
    return "\n".join(lines)


def side_by_side(files: Sequence[Path]) -> str:
    """Return the markdown table of several results: a cell holds the numbers of all runs, in the order of the files.

    Files of one label are one run. Rows: cards and captures of any run, then the mean over those that all runs have.
    """
    by_label: dict[str, dict[tuple[str, str], Row]] = {}
    for row in (row for path in files for row in read_rows(path)):
        by_label.setdefault(row["label"], {})[row["card"], row["capture"]] = row
    labels, runs = list(by_label), list(by_label.values())
    keys = list(dict.fromkeys(key for run in runs for key in run))
    lines = [f"In each cell: {' → '.join(labels)}.", "", _line(["card", "capture", *COMPARED.values()])]
    lines.append("|---" * (len(COMPARED) + 2) + "|")
    for key in keys:
        lines.append(_line([*key, *(" → ".join(_number(run.get(key), name) for run in runs) for name in COMPARED)]))
    shared = [key for key in keys if all(key in run for run in runs)]
    means = [_mean([run[key] for key in shared]) for run in runs]
    lines.append(_line(["mean", "", *(" → ".join(_number(mean, name) for mean in means) for name in COMPARED)]))
    return "\n".join(lines)


def read_rows(path: Path) -> list[Row]:
    """Return the rows of a result's JSON."""
    return json.loads(path.read_text(encoding="utf-8"))


def _mean(rows: Sequence[Row]) -> Row:
    means: Row = {}
    for name in COMPARED:
        values = [row[name] for row in rows if row[name] is not None]
        means[name] = sum(values) / len(values) if values else None
    return means


def _number(row: Row | None, key: str) -> str:
    if row is None or row[key] is None:
        return "–"
    return f"{row[key]:.{COLUMNS[key][1]}f}"


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
