"""Search for a 24-patch chart in a linear photograph: even patches, their lattice, and a test of the colours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...core.encode import srgb_from_linear
from ...core.errors import InputError
from ...core.opencv import opencv
from ..radiometry.colour_chart import COLUMNS, ROWS
from ..radiometry.colour_fit import Chart, ColourFit, Mirrored, orient_chart
from .lattice import Lattice, lattices, windows
from .quads import quads_of

_LONGEST = 1400  # pixels: most longer side of the searched image
_BRIGHT = 99.5  # percentile of the radiance that is displayed as white
EXPOSURES = (1.0, 4.0)  # the second is for a chart that is far darker than the rest
_HALF = 0.45  # of the pitch: from a patch's centre to its edge, as ``sample_chart`` has it
_MAX_LATTICES = 12
_FALL = 0.99  # most brightness of a grey patch over that of the one before; 0.65 without shading
_TINTED = 0.4  # most range of the grey row's tints, of mean 1: by a clipped patch, or coloured stray light
_SURE = 8.0  # most mean ΔE2000 after the fit; wrong orders of the patches leave 24 or more


@dataclass(frozen=True)
class FoundChart:
    """A chart in a photograph: its corners (4, 2) in its own order, pixels from the upper left; patches and fit."""

    corners: np.ndarray
    chart: Chart
    fit: ColourFit


def find_chart(rgba: np.ndarray, where: str) -> FoundChart | None:
    """Return the chart in a linear photograph (H, W, 4), row 0 at the bottom; None if there is none.

    It may have any orientation, perspective and tint, and needs patches of 6 pixels or more in an image of 1400. Raises
    InputError if the chart is mirrored or OpenCV is not installed.
    """
    small, factor = reduced(rgba, "the search for a colour chart")
    mirrored: Mirrored | None = None
    best: tuple[float, np.ndarray] | None = None
    for exposure in EXPOSURES:
        candidates = lattices(quads_of(as_shown(small, exposure)))
        for corners in _corners_of(candidates[:_MAX_LATTICES], small):
            try:
                ordered, _, fit = orient_chart(small, corners, where)
            except Mirrored as error:
                mirrored = error
                continue
            except InputError:
                continue
            mean = float(np.nanmean(fit.after))
            if mean <= _SURE and (best is None or mean < best[0]):
                best = mean, ordered
        if best is not None:
            break
    if best is None:
        if mirrored is not None:
            raise mirrored
        return None
    return FoundChart(*orient_chart(rgba, best[1] * factor, where))


def reduced(rgba: np.ndarray, what: str) -> tuple[np.ndarray, np.ndarray]:
    """Return a photograph of at most _LONGEST pixels, and the factors (2,) from its pixels to those of ``rgba``.

    what: names the work in the InputError if OpenCV is not installed.
    """
    cv = opencv(what)
    height, width = rgba.shape[:2]
    scale = min(1.0, _LONGEST / max(height, width))
    if scale == 1.0:
        return rgba, np.ones(2)
    size = round(width * scale), round(height * scale)
    small = cv.resize(rgba, size, interpolation=cv.INTER_AREA)
    small[..., 3] = small[..., 3] > 0.999  # clipped where one of the pixels is
    return small, np.array((width, height)) / size


def as_shown(rgba: np.ndarray, exposure: float) -> np.ndarray:
    """Return display codes (H, W, 3) uint8, row 0 at the top. Each channel has its own white, which removes a tint."""
    radiance = np.nan_to_num(rgba[::-1, :, :3])
    white = np.maximum(np.percentile(radiance.reshape(-1, 3), _BRIGHT, axis=0), 1e-9)
    return np.rint(255 * srgb_from_linear(np.clip(exposure * radiance / white, 0, 1))).astype(np.uint8)


def _corners_of(found: Sequence[Lattice], rgba: np.ndarray) -> list[np.ndarray]:
    """Return the corners (4, 2) of all fields of 6 × 4 patches of lattices, in the photograph, with a grey row."""
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
    """Return means (…, 3) of 3 × 3 pixels at positions (…, 2) from the upper left corner; row 0 at the bottom."""
    height, width = rgba.shape[:2]
    x = np.clip(places[..., 0].astype(int), 1, width - 2)
    y = np.clip(height - 1 - places[..., 1].astype(int), 1, height - 2)
    neighbours = [rgba[y + down, x + right, :3] for down in (-1, 0, 1) for right in (-1, 0, 1)]
    return np.mean(neighbours, axis=0)


def _has_grey_row(colours: np.ndarray) -> bool:
    """Return whether one of the long sides of a field (rows, columns, 3) darkens from patch to patch in one tint."""
    field = colours if colours.shape[1] == COLUMNS else colours.swapaxes(0, 1)
    for row in (field[0], field[0, ::-1], field[-1], field[-1, ::-1]):
        if not (row[1:].mean(axis=-1) < _FALL * row[:-1].mean(axis=-1)).all():
            continue
        tints = row[:-1] / np.maximum(row[:-1].mean(axis=-1, keepdims=True), 1e-9)  # noise tints the black patch
        if np.ptp(tints, axis=0).max() < _TINTED:
            return True
    return False
