"""Colour matrix from a photographed 24-patch chart: sampling, recognition of the orientation, fit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...capture.frame.homography import mapped
from ...capture.rectify import turns
from ...core.errors import InputError
from .colour_chart import COLUMNS, PATCHES, ROWS, patch_colours
from .colour_difference import delta_e_2000, lab_of_linear

NAMES = tuple(PATCHES)
COUNT = ROWS * COLUMNS
GREY = slice(COUNT - COLUMNS, COUNT)  # white to black
_GAP = 0.1  # of the pitch, between patches; an error of 0.1 moves no sample off its patch
_INNER = 0.5  # of a patch's side
_MIN_PIXELS = 9  # in a patch
_CLIPPED = 0.02  # of a patch's pixels
_MIN_PATCHES, _MIN_GREYS = 12, 3
# Mean ΔE2000 after the fit. For 60 random cameras and lamps, wrong orders of the patches leave 24 or more; an
# uncorrected gamma of 2.2 leaves 6.8, of 1.4 3.4.
_MAX_ERROR, _POOR = 12.0, 3.0
_ROUNDS, _SETTLED = 60, 1e-5
_MAX_GLOSS = 0.1  # reflectance: bound of the fit
_GLOSS_GAIN = 0.8  # of the mean ΔE2000 without gloss: gloss is used if it lowers the mean below


class Mirrored(InputError):
    """A photograph shows its chart mirrored."""


@dataclass(frozen=True)
class Chart:
    """Sampled patches in the order of ``PATCHES``. values: (24, 3) linear medians. usable: (24,) bool.

    left_out: reason → names of unusable patches. places: (24, 2), x to the right and y down the chart, −1…1 over its
    longer side.
    """

    values: np.ndarray
    usable: np.ndarray
    left_out: dict[str, list[str]]
    places: np.ndarray

    @property
    def left_out_text(self) -> str:
        """The patches left out, as text; empty where none is."""
        return "; ".join(f"{reason}: {', '.join(names)}" for reason, names in self.left_out.items() if names)


@dataclass(frozen=True)
class ColourFit:
    """matrix: (3, 3), camera's linear RGB to linear Rec. 709 reflectance, at the illumination of the chart's centre.

    shading: (2,) slopes of the log illumination over ``Chart.places``. gloss: reflectance that specular reflection adds
    to all patches. before, after: (24,) ΔE2000, NaN for unusable patches; before: brightness and shading corrected,
    colours and gloss not.
    """

    matrix: np.ndarray
    shading: np.ndarray
    gloss: float
    before: np.ndarray
    after: np.ndarray


def sample_chart(rgba: np.ndarray, corners: np.ndarray, where: str) -> Chart:
    """Measure the patches of a chart in a linear image (H, W, 4), row 0 at the bottom.

    corners: (4, 2) pixels from the upper left corner, from the outer corner of the dark skin patch toward that of the
    bluish green one. Raises InputError if they leave the image or cross.
    """
    corners = np.asarray(corners, np.float64)
    height, width = rgba.shape[:2]
    if not ((corners >= 0) & (corners <= (width, height))).all():
        raise InputError(f"{where}: a corner lies outside the photograph's {width}×{height} pixels")
    orientation = turns(corners)
    if not ((orientation > 0).all() or (orientation < 0).all()):
        raise InputError(f"{where}: the corners do not go around the chart; give them in order, clockwise")
    low, high = np.floor(corners.min(axis=0)).astype(int), np.ceil(corners.max(axis=0)).astype(int)
    x, y = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    chart = mapped(np.linalg.inv(_from_square(corners)), np.stack([x, y], axis=-1) + 0.5)
    # Patch n of a side reaches from n to n + 1 − gap, in pitches.
    cell = chart * (COLUMNS - _GAP, ROWS - _GAP)
    index = np.floor(cell).astype(int)
    offset = np.abs(cell - index - (1 - _GAP) / 2)
    inner = (offset < _INNER * (1 - _GAP) / 2).all(axis=-1) & (index >= 0).all(axis=-1)
    inner &= (index < (COLUMNS, ROWS)).all(axis=-1)
    number = index[..., 1] * COLUMNS + index[..., 0]
    pixels = rgba[height - high[1] : height - low[1], low[0] : high[0]][::-1]
    values = np.zeros((COUNT, 3))
    left_out: dict[str, list[str]] = {"clipped": [], "black": [], "too small": []}
    usable = np.ones(COUNT, bool)
    # Pixels grouped by patch.
    order = np.argsort(number[inner], kind="stable")
    ends = np.cumsum(np.bincount(number[inner], minlength=COUNT))
    patches = np.split(pixels[inner][order], ends[:-1])
    for n, (name, patch) in enumerate(zip(NAMES, patches, strict=True)):
        unclipped = patch[:, 3] > 0
        values[n] = np.median(patch[unclipped, :3], axis=0) if unclipped.any() else 0
        small, clipped = len(patch) < _MIN_PIXELS, (~unclipped).sum() > _CLIPPED * len(patch)
        if small or clipped or not (values[n] > 0).all():
            usable[n] = False
            left_out["too small" if small else "clipped" if clipped else "black"].append(name)
    row, column = np.divmod(np.arange(COUNT), COLUMNS)
    places = 2 * np.stack([column - (COLUMNS - 1) / 2, row - (ROWS - 1) / 2], axis=-1) / COLUMNS
    return Chart(values, usable, left_out, places)


def orient_chart(rgba: np.ndarray, corners: np.ndarray, where: str) -> tuple[np.ndarray, Chart, ColourFit]:
    """Try all eight orders of the corners; return them (4, 2) in the chart's order, its patches and their fit.

    Raises InputError if no order gives a chart or too few patches are usable, Mirrored if the photograph shows the
    chart mirrored.
    """
    corners = np.asarray(corners, np.float64)
    best: tuple[np.ndarray, Chart, ColourFit] | None = None
    least, given = np.inf, None
    for order in (corners, corners[::-1]):
        for first in range(4):
            rotated = np.roll(order, -first, axis=0)
            chart = sample_chart(rgba, rotated, where)
            given = given or chart
            if chart.usable.sum() < _MIN_PATCHES or chart.usable[GREY].sum() < _MIN_GREYS:
                continue
            fit = fitted(chart)
            error = float(np.nanmean(fit.after))
            if error < least:
                best, least = (rotated, chart, fit), error
    if best is None:
        assert given is not None
        raise InputError(
            f"{where}: only {given.usable.sum()} of {COUNT} patches can be measured ({given.left_out_text}), needed are"
            f" {_MIN_PATCHES}, {_MIN_GREYS} of them grey"
        )
    if not least <= _MAX_ERROR or not _greys_darken(best[1], best[2]):
        raise InputError(
            f"{where}: the corners enclose no 24-patch chart (ΔE2000 {least:.0f} after the best matrix); check their"
            " places, and that the photograph is linear (--response)"
        )
    if not (turns(best[0]) > 0).all():
        raise Mirrored(f"{where}: the photograph shows the chart mirrored; undo the mirroring of all photographs")
    return best


def fitted(chart: Chart) -> ColourFit:
    """Fit a white-preserving matrix, planar log shading and gloss to the published colours of a chart's patches.

    Minimises Σ |J (M m exp(−p·x) − g − t)|² over M, p and g ≥ 0: m and t are a patch's measured and published colour, x
    its place. J is the Jacobian of CIELAB at t, in the axes and tolerances of CIE94, so the terms are squared perceived
    differences. M w = 1 for the mean white w of the grey row (Finlayson & Drew 1997), so greys stay neutral. A varnish
    reflects the lamp's colour (Shafer 1985), which adds g to all channels. g is 0 unless it lowers the mean ΔE2000 by
    20 %, because noise of the dark patches resembles gloss.
    """
    matt = _fit(chart, 0.0)
    if (mean := np.nanmean(matt.after)) > 2 * _MAX_ERROR:
        return matt
    shiny = _fit(chart, _MAX_GLOSS)
    return shiny if np.nanmean(shiny.after) < _GLOSS_GAIN * mean else matt


def _fit(chart: Chart, max_gloss: float) -> ColourFit:
    """Return the fit with a gloss from 0 to ``max_gloss``."""
    published, use = patch_colours().reshape(COUNT, 3), chart.usable
    measured, target, x = chart.values[use], published[use], chart.places[use]
    grey = np.flatnonzero(use[GREY]) + GREY.start
    tolerance = _tolerances(target)
    matrix, slopes, gloss = np.eye(3), np.zeros(2), 0.0
    for _ in range(_ROUNDS):
        unshaded = measured * np.exp(-x @ slopes)[:, None]
        white = _white(chart.values[grey] * np.exp(-chart.places[grey] @ slopes)[:, None], published[grey] + gloss)
        fixed = np.outer(np.ones(3), white) / (white @ white)
        free = np.linalg.svd(white[None])[2][1:]  # (2, 3), orthogonal to white
        # Unknown: P (3, 2) of M = fixed + P free, row by row, the change of the slopes, and the gloss.
        columns = np.einsum("ij,nk->nijk", np.eye(3), unshaded @ free.T).reshape(-1, 3, 6)
        by_slope = -(target + gloss)[:, :, None] * x[:, None, :]
        left = (tolerance @ np.concatenate([columns, by_slope, -np.ones((len(x), 3, 1))], axis=-1)).reshape(-1, 9)
        right = (tolerance @ (target - unshaded @ fixed.T)[..., None]).ravel()
        solution = np.linalg.lstsq(left, right, rcond=None)[0]
        previous, gloss = gloss, float(np.clip(solution[8], 0, max_gloss))
        if gloss != solution[8]:
            solution = np.linalg.lstsq(left[:, :8], right - gloss * left[:, 8], rcond=None)[0]
        matrix = fixed + solution[:6].reshape(3, 2) @ free
        slopes = np.clip(slopes + solution[6:8], -3, 3)
        if max(abs(gloss - previous), *np.abs(solution[6:8])) < _SETTLED:
            break
    unshaded = chart.values * np.exp(-chart.places @ slopes)[:, None]
    # Scaled by the green of white: brightness corrected, colours of the file.
    before = _differences(unshaded / white[1], published, use)
    return ColourFit(matrix, slopes, gloss, before, _differences(unshaded @ matrix.T - gloss, published, use))


def chart_report(corners: np.ndarray, chart: Chart, fit: ColourFit) -> dict:
    """Return the report of a chart: corners, matrix, shading, gloss, ΔE2000, patches left out."""

    def figures(differences: np.ndarray) -> dict:
        return {"mean": round(float(np.nanmean(differences)), 3), "largest": round(float(np.nanmax(differences)), 3)}

    extent = np.ptp(chart.places, axis=0)
    return {"corners": corners.ravel().round(3).tolist(), "matrix": fit.matrix.round(6).tolist(),
            "brightness_right_over_left": round(float(np.exp(extent[0] * fit.shading[0])), 4),
            "brightness_bottom_over_top": round(float(np.exp(extent[1] * fit.shading[1])), 4),
            "gloss": round(fit.gloss, 4),
            "delta_e_2000": {"before": figures(fit.before), "after": figures(fit.after)},
            "delta_e_2000_of_patches": {name: round(float(value), 2)
                                        for name, value in zip(NAMES, fit.after, strict=True) if np.isfinite(value)},
            "left_out": {reason: names for reason, names in chart.left_out.items() if names}}  # fmt: skip


def chart_warnings(where: str, stated: np.ndarray, corners: np.ndarray, chart: Chart, fit: ColourFit) -> Iterator[str]:
    """Yield warnings: corrected order of the corners, patches left out, gloss, a poor fit."""
    if not np.array_equal(stated, corners):
        first = ",".join(f"{value:g}" for value in corners[0])
        yield f"{where}: the corners were not given clockwise from the dark skin patch, which is at {first}: corrected"
    if not chart.usable.all():
        yield f"{where}: patches left out, {chart.left_out_text}"
    if fit.gloss == _MAX_GLOSS:
        yield f"{where}: the chart shines ({fit.gloss:.0%} of white), so its colours are doubtful; light it from a side"
    if (mean := float(np.nanmean(fit.after))) > _POOR:
        yield (
            f"{where}: ΔE2000 is still {mean:.1f} on average; check that the photograph is linear (--response), the"
            " corners are exact and no reflection lies on the chart"
        )


def _from_square(corners: np.ndarray) -> np.ndarray:
    """Return the projective map (3, 3) of the unit square's corners, from (0, 0) to (1, 0), onto ``corners``."""
    rows = []
    for (u, v), (x, y) in zip(((0, 0), (1, 0), (1, 1), (0, 1)), corners, strict=True):
        rows += [(u, v, 1, 0, 0, 0, -u * x, -v * x), (0, 0, 0, u, v, 1, -u * y, -v * y)]
    return np.append(np.linalg.solve(np.array(rows, np.float64), corners.ravel()), 1).reshape(3, 3)


def _white(greys: np.ndarray, published: np.ndarray) -> np.ndarray:
    """Return the values (3,) of a reflectance of 1, from grey patches (N, 3); dark ones weigh less: glare."""
    weight = published.mean(axis=1) / (published.mean(axis=1) + 0.05)
    return np.exp((weight[:, None] * np.log(greys / published)).sum(axis=0) / weight.sum())


def _tolerances(target: np.ndarray) -> np.ndarray:
    """Return the Jacobian (N, 3, 3) of lightness, chroma and hue, over CIE94's tolerances, by linear RGB."""
    step = 1e-4
    lab = lab_of_linear(target)
    slope = np.stack([(lab_of_linear(target + step * axis) - lab) / step for axis in np.eye(3)], axis=-1)
    chroma = np.maximum(np.hypot(lab[:, 1], lab[:, 2]), 1e-9)
    across, along = lab[:, 1] / chroma, lab[:, 2] / chroma
    rotation = np.zeros((len(target), 3, 3))
    rotation[:, 0, 0] = 1
    rotation[:, 1, 1:] = np.stack([across, along], axis=-1) / (1 + 0.045 * chroma)[:, None]
    rotation[:, 2, 1:] = np.stack([-along, across], axis=-1) / (1 + 0.015 * chroma)[:, None]
    return rotation @ slope


def _differences(measured: np.ndarray, published: np.ndarray, use: np.ndarray) -> np.ndarray:
    return np.where(use, delta_e_2000(lab_of_linear(measured), lab_of_linear(published)), np.nan)


def _greys_darken(chart: Chart, fit: ColourFit) -> bool:
    """Return whether each grey patch is darker than the one before."""
    unshaded = (chart.values * np.exp(-chart.places @ fit.shading)[:, None])[GREY][chart.usable[GREY]]
    return bool((np.diff(unshaded.mean(axis=1)) < 0).all())
