"""``develop CAPTURE``: writes linear images of photographs, one per light, with the capture's lists."""

from __future__ import annotations

import sys
from argparse import Namespace
from pathlib import Path

import numpy as np

from ..blender.images import decode
from ..calibration.developing.greys import AUTO
from ..calibration.developing.measure import MeasureOptions, Output, SearchedCard
from ..calibration.developing.write import develop_steps
from ..calibration.radiometry.frames import Patch
from ..calibration.radiometry.source import Exposing, read_source
from ..capture.images.image import ImageStore
from ..core.errors import InputError
from ..core.files import check_unused
from ..core.progress_bar import ProgressBar
from .options.photographs import (
    corners_option,
    exposures_option,
    files_option,
    greys_option,
    number_list,
    patch_option,
    reflectance_of,
)
from .options.values import silent, warn

_SHOWN = ("images", "warnings", "white_gains", "grey_card", "colour_chart", "shifts")


def run(options: Namespace) -> dict:
    """Develop all photographs into a new folder. Raises InputError and then writes nothing."""
    out = Path(options.output)
    check_unused(out)
    measuring = _measure_options(options)
    exposing, colour_space = measuring.exposing, options.colour_space
    source = read_source(options.capture, decode, exposing, colour_space, measuring.left_out, options.bursts)
    bar = ProgressBar("develop", silent(options))
    settings = {k: v for k, v in vars(options).items() if k not in ("command", "json", "quiet") and v}
    report = bar.run(develop_steps(ImageStore(decode), source, measuring, out, settings), tuple)
    warn(report["warnings"])
    summary = {key: report[key] for key in _SHOWN if key in report}
    if options.bursts and not silent(options):
        taken = sum(len(group.images) for group in source.groups)
        sys.stdout.write(f"bursts: {taken} photographs averaged to {len(source.groups)}\n")
    if "grey_card" in summary and not silent(options):
        sys.stdout.write(
            "grey card: found in {file} at {patch}; look whether it is the card\n".format(**summary["grey_card"])
        )
    if "colour_chart" in summary and not silent(options):
        sys.stdout.write(_colours(summary["colour_chart"]))
    return {"output": options.output, **summary, "images": len(source.groups)}


def _measure_options(options: Namespace) -> MeasureOptions:
    """Return the options as ``MeasureOptions``. Raises InputError naming the option."""
    if options.scale_dark and not options.dark:
        raise InputError("--scale-dark: there are no dark frames to scale; give --dark, or leave it out")
    if options.chart and not (options.grey_card or options.white or options.colour_chart):
        raise InputError(
            "--chart: names where patches are; say which, with --colour-chart, --white or --grey-card, or leave it out"
        )
    corners: np.ndarray | str | None = None
    if options.colour_chart:
        auto = options.colour_chart == AUTO
        corners = AUTO if auto else corners_option("--colour-chart", options.colour_chart)
    return MeasureOptions(
        response=Path(options.response) if options.response else None,
        greys=greys_option(options.grey_card),
        chart=Path(options.chart) if options.chart else None,
        darks=tuple(files_option("--dark", options.dark)),
        scale_dark=options.scale_dark,
        flats=tuple(files_option("--flat", options.flat)),
        white=_white(options.white) if options.white else None,
        colour_chart=corners,
        exposing=exposing_option(options),
        saturated=options.saturated,
        colour_space=options.colour_space,
        output=Output(options.register, options.reference, options.half),
    )


def exposing_option(options: Namespace) -> Exposing | None:
    """Return the source of exposures, by --brackets, --exposure and --exposures. Raises InputError."""
    if options.brackets and options.exposure:
        raise InputError("--brackets merges what --exposure would scale frame by frame; give one of them")
    source = options.brackets or options.exposure
    exposures = exposures_option(options.exposures, source)
    return Exposing(source, bool(options.brackets), exposures) if source else None


def _white(text: str) -> Patch | SearchedCard | tuple[float, float, float]:
    place, equals, value = text.partition("=")
    if place.strip() == AUTO:
        return SearchedCard(reflectance_of("--white", text, value) if equals else None)
    if text.count(",") != 2:
        return patch_option("--white", text)
    red, green, blue = number_list("--white", text)
    if not all(0 < gain < float("inf") for gain in (red, green, blue)):
        raise InputError(f"--white {text}: gains are above 0, as in --white 1.9,1,1.4")
    return red, green, blue


def _colours(chart: dict) -> str:
    before, after = chart["delta_e_2000"]["before"], chart["delta_e_2000"]["after"]
    means, largest = (f"{before[key]:.1f} → {after[key]:.1f}" for key in ("mean", "largest"))
    place = ""
    if "found" in chart:
        corners = np.reshape(chart["corners"], (4, 2))
        place = f"colour chart: found in {chart['file']} at {','.join(f'{v:.0f}' for v in corners.ravel())}\n"
    shine = f"; it shines by {chart['gloss']:.1%} of white, which is kept out" if chart["gloss"] else ""
    return f"{place}colour chart: ΔE2000 mean {means}, largest {largest}{shine}\n"
