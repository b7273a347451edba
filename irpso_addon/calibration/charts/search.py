"""Finds a 24-patch chart in a linear photograph: even patches, their lattice, and the colours as the test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...core.encode import srgb_from_linear
from ...core.errors import InputError
from ...core.opencv import opencv
from ..radiometry.colour_chart import COLUMNS, ROWS
from ..radiometry.colour_fit import Chart, ColourFit, Mirrored, recognised
from .lattice import Lattice, lattices, windows
from .quads import quads_of

_LONGEST = 1400  # pixels: longer side of the picture that is searched
_BRIGHT = 99.5  # percentile of the brightness that becomes white
EXPOSURES = (1.0, 4.0)  # the second shows a chart that is far darker than the rest
_HALF = 0.45  # of the pitch: from a patch's centre to its edge, as ``sample_chart`` has it
_MOST_LATTICES = 12
_FALL = 0.99  # of a grey patch's brightness, at most that of the next one; 0.65 without shading
_TINTED = 0.4  # by how much the grey row's tints, of mean 1, may differ: a patch that clips, or colours of light around
_SURE = 8.0  # mean ΔE2000 after the fit: what is left of a wrong order is 24 or more


@dataclass(frozen=True)
class FoundChart:
    """A chart in a photograph: its corners (4, 2) in its own order, pixels from the upper left; patches and fit."""

    corners: np.ndarray
    chart: Chart
    fit: ColourFit


def find_chart(rgba: np.ndarray, where: str) -> FoundChart | None:
    """Return the chart in a linear photograph (H, W, 4), row 0 at the bottom; None if there is none.

    Any turn, perspective and tint; patches of 6 pixels or more in a picture of 1400. Raises InputError where the chart
    is mirrored or OpenCV is not installed.
    """
    small, factor = reduced(rgba, "the search for a colour chart")
    mirrored: Mirrored | None = None
    best: tuple[float, np.ndarray] | None = None
    for exposure in EXPOSURES:
        found = lattices(quads_of(as_shown(small, exposure)))
        for corners in _corners_of(found[:_MOST_LATTICES], small):
            try:
                turned, _, fit = recognised(small, corners, where)
            except Mirrored as error:
                mirrored = error
                continue
            except InputError:
                continue
            mean = float(np.nanmean(fit.after))
            if mean <= _SURE and (best is None or mean < best[0]):
                best = mean, turned
        if best is not None:
            break
    if best is None:
        if mirrored is not None:
            raise mirrored
        return None
    return FoundChart(*recognised(rgba, best[1] * factor, where))


def reduced(rgba: np.ndarray, what: str) -> tuple[np.ndarray, np.ndarray]:
    """Return a photograph of _LONGEST pixels at most, and the factors (2,) from its pixels to the photograph's.

    what: the work, for the InputError where OpenCV is not installed.
    """
    cv = opencv(what)
    height, width = rgba.shape[:2]
    share = min(1.0, _LONGEST / max(height, width))
    if share == 1.0:
        return rgba, np.ones(2)
    size = round(width * share), round(height * share)
    small = cv.resize(rgba, size, interpolation=cv.INTER_AREA)
    small[..., 3] = small[..., 3] > 0.999  # clipped where one of the pixels is
    return small, np.array((width, height)) / size


def as_shown(rgba: np.ndarray, exposure: float) -> np.ndarray:
    """Return (H, W, 3) uint8 as a screen shows it, row 0 at the top. Each channel is scaled, which undoes a tint."""
    light = np.nan_to_num(rgba[::-1, :, :3])
    white = np.maximum(np.percentile(light.reshape(-1, 3), _BRIGHT, axis=0), 1e-9)
    return np.rint(255 * srgb_from_linear(np.clip(exposure * light / white, 0, 1))).astype(np.uint8)


def _corners_of(found: Sequence[Lattice], rgba: np.ndarray) -> list[np.ndarray]:
    """Return corners (4, 2) of all fields of 6 × 4 patches with a grey row that lattices may show in a photograph."""
    size, result = rgba.shape[1::-1], []
    for lattice in found:
        for columns, rows in ((COLUMNS, ROWS), (ROWS, COLUMNS)):
            for first in windows(lattice.cells, columns, rows):
                low, high = np.array(first) - _HALF, np.array(first) + (columns - 1 + _HALF, rows - 1 + _HALF)
                places = np.array([(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])])
                corners = lattice.at(places)
                if not np.isfinite(corners).all() or not ((corners >= 0) & (corners <= size)).all():
                    continue
                centres = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1) + first
                if _has_grey_row(_colours(rgba, lattice.at(centres))):
                    result.append(corners)
    return result


def _colours(rgba: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return (…, 3) means of 3 × 3 pixels about places (…, 2) of a photograph, whose row 0 is at the bottom."""
    height, width = rgba.shape[:2]
    x = np.clip(places[..., 0].astype(int), 1, width - 2)
    y = np.clip(height - 1 - places[..., 1].astype(int), 1, height - 2)
    around = [rgba[y + down, x + right, :3] for down in (-1, 0, 1) for right in (-1, 0, 1)]
    return np.mean(around, axis=0)


def _has_grey_row(colours: np.ndarray) -> bool:
    """Return whether one of the long sides of a field (rows, columns, 3) darkens from patch to patch, in one tint."""
    field = colours if colours.shape[1] == COLUMNS else colours.swapaxes(0, 1)
    for row in (field[0], field[0, ::-1], field[-1], field[-1, ::-1]):
        if not (row[1:].mean(axis=-1) < _FALL * row[:-1].mean(axis=-1)).all():
            continue
        tints = row[:-1] / np.maximum(row[:-1].mean(axis=-1, keepdims=True), 1e-9)  # noise tints the black patch
        if np.ptp(tints, axis=0).max() < _TINTED:
            return True
    return False
