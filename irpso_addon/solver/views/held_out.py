"""Observations held out of the fit: their choice, their order in the stack, and the maps' error on them."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ...capture.types import Capture
from ...core.optional import present
from ...core.steps import one_step
from ...geometry.domain import Domain
from ...reflectance.model import ReflectanceModel, load_model
from ...results.maps import Maps
from ...results.preview import PreviewRow, on_one_scale, preview
from .forward import rendered
from .pictures import SHOWN_WHITE, Indirect, image_psnr, image_row, no_indirect

_STEP, _MAX_HELD_OUT = 8, 6  # of the automatic choice
MIN_OBSERVATIONS = _STEP // 2 + 1  # least observations of a capture that holds one out
RELIT_LINES = (  # with no, one and both figures
    "Unseen photographs: nothing to compare",
    "Unseen photographs: RMS error {error}",
    "Unseen photographs: RMS error {error}, in highlights {highlights}",
)
HIGHLIGHT = 1.5  # a highlight exceeds the diffuse reflection by this factor …
_DARK = 0.02  # … and by this fraction of the photograph's 99.5th percentile, to exceed noise
_FEW, _SHARE = 10, 1e-3  # texels, and part of the compared ones: fewer highlights are not reported


def spared(cameras: Sequence[int]) -> list[int]:
    """Return the indices that the automatic choice holds out of observations, [] for fewer than ``MIN_OBSERVATIONS``.

    One in eight, evenly spaced, at most six, because the fit cannot use them. cameras: of each observation. Cameras
    often list the same lamps in one order: none is held out at the place of its camera's list where another is.
    """
    step = max(_STEP, math.ceil(len(cameras) / _MAX_HELD_OUT))
    places = [list(cameras[:k]).count(camera) for k, camera in enumerate(cameras)]
    chosen: list[int] = []
    for middle in range(step // 2, len(cameras), step):
        near = range(middle - step // 2, min(middle - step // 2 + step, len(cameras)))
        taken = [places[k] for k in chosen]
        chosen.append(min(near, key=lambda k: (taken.count(places[k]), abs(k - middle))))
    return chosen


def held_out_last(capture: Capture, held_out: Sequence[int]) -> tuple[Capture, list[int]]:
    """Return the capture with the held-out observations last: then the fitted ones are contiguous in the stack."""
    order = order_of(len(capture.observations), held_out)
    count = len(order) - len(held_out)
    observations = tuple(capture.observations[k] for k in order)
    return replace(capture, observations=observations), list(range(count, len(order)))


def order_of(count: int, held_out: Sequence[int]) -> list[int]:
    """Return the former index of each observation of ``held_out_last``."""
    return [*(k for k in range(count) if k not in held_out), *held_out]


def preview_names(capture: Capture, held_out: Sequence[int]) -> list[str]:
    """Return the observations' names for pictures, with a mark on those held out."""
    return [observation.name + " (held out)" * (k in held_out) for k, observation in enumerate(capture.observations)]


def distinct_names(names: Sequence[str], numbers: Sequence[int]) -> list[str]:
    """Return photographs' names, with their number where several have one name."""
    return [
        f"{name} (number {number})" if names.count(name) > 1 else name
        for name, number in zip(names, numbers, strict=True)
    ]


def relit_steps(
    domain: Domain,
    maps: Maps,
    held_out: Sequence[int],
    names: Sequence[str],
    threaded: Callable[[Callable[[], Any]], Generator[None, None, Any]] = one_step,
    indirect: Indirect = no_indirect,
) -> Generator[None, None, tuple[dict[str, np.ndarray], dict[str, Any]]]:
    """Yield often; return pictures and figures, both {} without observations.

    domain: of all observations. names: of all, each different. threaded: runs a numpy function in a thread and yields
    until it ends. indirect: the light that is added to the render of an observation. The figures are the PSNR in dB of
    each observation and of its highlights alone, their means, and the factor over the diffuse reflection that defines a
    highlight; None where there are no samples to compare.
    """
    if not held_out:
        return {}, {}
    names = [names[k] for k in held_out]
    bright, rows = [], []
    yield
    for k, diffuse in zip(held_out, rendered(domain, *_diffuse(domain, maps), held_out), strict=True):
        shaded = diffuse[..., :3] + indirect(k)
        bright.append((yield from threaded(partial(_highlights, domain, maps, k, shaded))))
    yield
    for k, name, render in zip(held_out, names, rendered(domain, maps.model, maps.values, held_out), strict=True):
        lit = render[..., :3] + indirect(k)
        rows.append((yield from threaded(partial(image_row, domain, maps, k, name, lit))))
    figures = yield from threaded(lambda: _figures(names, rows, bright))
    picture = yield from threaded(lambda: preview(on_one_scale(rows), ("Photograph", "Relit", "Error")))
    return {"relit": picture}, figures


def relit_line(figures: Mapping[str, Any], translated: Callable[[str], str] = str) -> str:
    """Return the means of a report's figures as one line for display, "" where nothing was held out.

    The percentages are RMS errors of display values, in parts of white: geometric means over the photographs.
    translated: returns one of ``RELIT_LINES`` in the reader's language.
    """
    if "relighting_mean_psnr_db" not in figures:
        return ""
    psnr, highlights = figures["relighting_mean_psnr_db"], figures["relighting_highlights_mean_psnr_db"]
    known = {"error": psnr, "highlights": highlights}
    known = {name: _error_of(value) for name, value in known.items() if value is not None}
    return translated(RELIT_LINES[len(known)]).format(**known)


def _error_of(psnr: float) -> str:
    return f"{10 ** (-psnr / 20):.1%} ({psnr:.1f} dB)"


def _highlights(domain: Domain, maps: Maps, k: int, diffuse: np.ndarray) -> np.ndarray:
    """Return (H, W) bool: texels at which a photograph is far brighter than the diffuse render (H, W, 3).

    This includes highlights that the fit has missed.
    """
    brightness = np.nan_to_num(domain.stack.layer(k)[..., :3]).mean(axis=-1)
    floor = _DARK * np.percentile(brightness[maps.solved], SHOWN_WHITE)
    return brightness > HIGHLIGHT * diffuse.mean(axis=-1) + floor


def _diffuse(domain: Domain, maps: Maps) -> tuple[ReflectanceModel, dict[str, np.ndarray]]:
    """Return the model lambert, and its values: the base colours times 1 − metallic."""
    normal = maps.model.normal
    diffuse = np.zeros((*domain.shape, 3), np.float32)
    for parameter in maps.model.parameters:
        if parameter.is_albedo:
            diffuse += maps.values[parameter.name]
    for parameter in maps.model.parameters:
        if parameter.socket == "Metallic":
            diffuse *= 1 - maps.values[parameter.name]
    return load_model("lambert"), {"base_color": diffuse, "normal": maps.values[normal]}


def _figures(names: Sequence[str], rows: Sequence[PreviewRow], bright: Sequence[np.ndarray]) -> dict[str, Any]:
    psnr = [image_psnr(row) for row in rows]
    highlights = [_highlights_psnr(row, at) for row, at in zip(rows, bright, strict=True)]
    return {
        "relighting_psnr_db": dict(zip(names, map(_decibels, psnr), strict=True)),
        "relighting_highlights_psnr_db": dict(zip(names, map(_decibels, highlights), strict=True)),
        "relighting_mean_psnr_db": _mean(psnr),
        "relighting_highlights_mean_psnr_db": _mean(highlights),
        "relighting_highlights_factor": HIGHLIGHT,
    }


def _highlights_psnr(row: PreviewRow, highlights: np.ndarray) -> float:
    """Return the PSNR of highlights (H, W) bool, NaN for so few that they may be noise in shadows."""
    compared = present(row.compared)
    counted, least = compared & highlights, max(_FEW, _SHARE * np.count_nonzero(compared))
    return image_psnr(replace(row, counted=counted)) if np.count_nonzero(counted) >= least else math.nan


def _mean(values: Sequence[float]) -> float | None:
    finite = [value for value in values if math.isfinite(value)]
    return _decibels(sum(finite) / len(finite)) if finite else None


def _decibels(psnr: float) -> float | None:
    return round(psnr, 3) if math.isfinite(psnr) else None
