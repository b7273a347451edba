"""Maps of a card that repeat without a seam: all are cut along one path through an overlap (Efros & Freeman 2001).

The overlap is blended in bands, wide for what is smooth and narrow for detail (Burt & Adelson 1983), so that neither a
slow change of colour ends at the path nor detail fades beside it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..core.errors import InputError
from ..core.filters import blurred
from ..reflectance.model import ReflectanceModel

_OVERLAPS = 0.2, 0.4  # of the side: between these the overlap is chosen
_ALIKE = 1.2  # of the least cost of a path: among overlaps so good the smallest are taken
_STRETCH = 0.03  # by which one direction may be stretched against the other
_SEARCHED = 256  # texels of a side that is searched for the overlap
_LEAST = 32  # texels of a side
_FREE = 0.3  # of the overlap at each side, which the path keeps away from
_FINEST, _WIDEST = 1.0, 1 / 20  # deviations of the blend's bands: texels, of the overlap; six are _FREE
_SMOOTH = 1.0  # texels: differences are compared in the mean of their surroundings


@dataclass(frozen=True)
class Seamless:
    """values: parameter name → (N, N, components), which continue at their opposite borders. crop: x, y and side of
    the square of the card that is used, from the lower left. period: its columns and rows that repeat. seam:
    differences between neighbours across the paths, over those of all neighbours in this direction: 1 is no seam;
    plain: those of the square repeated as it is.
    """

    values: dict[str, np.ndarray]
    crop: tuple[int, int, int]
    period: tuple[int, int]
    seam: float
    plain: float


def seamless(
    model: ReflectanceModel, values: Mapping[str, np.ndarray], covered: np.ndarray, size: int | None = None,
    overlap: float | None = None,
) -> Seamless:  # fmt: skip
    """Return maps that repeat. values: (H, W, components); covered: (H, W) bool.

    The largest square of covered texels is used. size: texels of a side, by default the power of two that the card's
    texels fill; 0: those of the period, which may be no square. overlap: of the square's side, which is lost to the
    blend; by default the one whose ends match, so that a weave or a bond of bricks continues. Raises InputError where
    the square is too small.
    """
    x, y, side = largest_square(covered)
    if side < _LEAST or side * (1 - (overlap or 0)) < _LEAST // 2:
        raise InputError(f"the card's largest square without holes has {side} texels a side; {_LEAST} are needed")
    names = [parameter.name for parameter in model.parameters]
    square = {name: np.asarray(values[name], np.float64)[y : y + side, x : x + side] for name in names}
    stack = np.concatenate([square[name] for name in names], axis=-1)
    scale = np.concatenate([_scale(model, name, square[name]) for name in names])
    over, above = (round(overlap * side),) * 2 if overlap else _matching_overlaps(stack / scale)
    plain = _steps_over_wrap(stack / scale)
    across, first = _joined(stack, scale, over, wraps=False)
    turned, second = _joined(across.swapaxes(0, 1), scale, above, wraps=True)
    whole = turned.swapaxes(0, 1)
    period = (side - over, side - above)
    seam = float(np.mean([first, second]))
    if size != 0:
        size = size or 2 ** int(np.log2(min(period)))
        whole = _resized(_resized(whole, size).swapaxes(0, 1), size).swapaxes(0, 1)
    found, at = {}, 0
    for parameter in model.parameters:
        part = whole[..., at : at + square[parameter.name].shape[-1]]
        at += part.shape[-1]
        if parameter.is_normal:
            part = part / np.maximum(np.linalg.norm(part, axis=-1, keepdims=True), 1e-9)
        found[parameter.name] = np.clip(part, *parameter.range).astype(np.float32)
    return Seamless(found, (x, y, side), period, seam, plain)


def largest_square(covered: np.ndarray) -> tuple[int, int, int]:
    """Return x, y and side of the largest square of covered texels (H, W); the one nearest to the middle of several."""
    sums = np.pad(covered.astype(np.int64).cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))

    def squares(side: int) -> np.ndarray:
        """Return whether the square from each texel, its lower left one, is whole."""
        corners = sums[side:, side:] - sums[:-side, side:] - sums[side:, :-side] + sums[:-side, :-side]
        return corners == side**2

    side, over = 0, min(covered.shape) + 1
    while over - side > 1:
        tried = (side + over) // 2
        side, over = (tried, over) if squares(tried).any() else (side, tried)
    if not side:
        return 0, 0, 0
    rows, columns = np.nonzero(squares(side))
    middles = np.stack([columns + (side - 1) / 2, rows + (side - 1) / 2], axis=-1)
    best = np.linalg.norm(middles - (np.array(covered.shape[::-1]) - 1) / 2, axis=-1).argmin()
    return int(columns[best]), int(rows[best]), side


def _scale(model: ReflectanceModel, name: str, values: np.ndarray) -> np.ndarray:
    """Return (components,) what a difference of a map counts by: its deviation, at least a hundredth of its range."""
    parameter = model.parameter(name)
    least = 0.01 * (2.0 if parameter.is_normal else float(np.ptp(parameter.range)))
    return np.full(values.shape[-1], max(float(values.std(axis=(0, 1)).mean()), least))


def _joined(stack: np.ndarray, scale: np.ndarray, over: int, wraps: bool) -> tuple[np.ndarray, float]:
    """Return maps (H, W − over, C) that continue from the last column to the first, and how visible the path is.

    wraps: the rows continue already; then the path does, too.
    """
    cost = _path_costs(stack / scale, over, wraps)
    path = (over - cost.shape[1]) // 2 + cheapest_path(cost, wraps)
    mask = (np.arange(over) < path[:, None]).astype(np.float64)  # 1 where the right end is seen
    blend = _blended(stack, over, mask, wraps)
    whole = np.concatenate([blend, stack[:, over:-over]], axis=1)
    rows = np.arange(len(whole))
    steps = np.abs(np.diff(whole / scale, axis=1)).sum(axis=-1)
    return whole, float(steps[rows, path - 1].mean() / steps.mean())


def _path_costs(stack: np.ndarray, over: int, wraps: bool) -> np.ndarray:
    """Return (H, W) how different both ends of maps in their scales are, where a path may run in their overlap."""
    cost = ((stack[:, :over] - stack[:, -over:]) ** 2).sum(axis=-1)
    cost = blurred(np.pad(cost, ((over, over), (0, 0)), mode="wrap"), _SMOOTH)[over:-over] if wraps else blurred(
        cost, _SMOOTH)  # fmt: skip
    free = round(_FREE * over)
    return cost[:, free : over - free]


def _matching_overlaps(stack: np.ndarray) -> tuple[int, int]:
    """Return the overlaps along rows and along columns, in texels, at which the ends of maps (N, N, C), in their
    scales, match; what is left of both directions differs by _STRETCH at most.

    All are tried in means of equal parts; then those beside the best, in ever smaller parts.
    """
    step = 2 ** max(0, int(np.ceil(np.log2(len(stack) / _SEARCHED))))
    coarse = _means(stack, step)
    low, high = (round(share * len(coarse)) for share in _OVERLAPS)
    tried = np.arange(low, high + 1)
    rows, columns = (_least_costs(maps, tried) for maps in (coarse, coarse.swapaxes(0, 1)))
    left = len(coarse) - tried
    costs = rows[:, None] + columns
    costs[np.abs(np.log(left[:, None] / left)) > np.log1p(_STRETCH)] = np.inf
    good = costs <= _ALIKE * costs.min()
    chosen = np.unravel_index(np.where(good, np.add.outer(left, left), 0).argmax(), costs.shape)
    over, above = int(tried[chosen[0]]), int(tried[chosen[1]])
    while step > 1:
        step //= 2
        finer = _means(stack, step)
        over, above = _best_beside(finer, 2 * over), _best_beside(finer.swapaxes(0, 1), 2 * above)
    return over, above


def _means(stack: np.ndarray, step: int) -> np.ndarray:
    """Return the means of squares of step × step texels; what is left over at the ends does not count."""
    count = len(stack) // step
    return stack[: count * step, : count * step].reshape(count, step, count, step, -1).mean(axis=(1, 3))


def _best_beside(stack: np.ndarray, over: int) -> int:
    near = over + np.arange(-2, 3)
    return int(near[_least_costs(stack, near).argmin()])


def _least_costs(stack: np.ndarray, overlaps: np.ndarray) -> np.ndarray:
    """Return the mean cost of the cheapest path through each overlap along the rows."""
    found = []
    for over in overlaps:
        cost = _path_costs(stack, int(over), wraps=False)
        found.append(cost[np.arange(len(cost)), cheapest_path(cost)].mean())
    return np.array(found)


def cheapest_path(cost: np.ndarray, wraps: bool = False) -> np.ndarray:
    """Return (H,) the columns of the path from the first row of costs (H, W) to the last that has the least sum.

    From row to row it moves by one column at most; wraps: from the last row to the first, too.
    """
    if wraps:  # the middle of three rounds, begun again where it passes
        start = int(cheapest_path(np.concatenate([cost] * 3))[len(cost)])
        cost = cost.copy()
        cost[0, np.arange(cost.shape[1]) != start] = np.inf
        closed = cheapest_path(np.concatenate([cost, cost[:1]]))
        return closed[:-1]
    total, way = cost[0], []
    for row in cost[1:]:
        padded = np.pad(total, 1, constant_values=np.inf)
        near = np.stack([padded[:-2], padded[1:-1], padded[2:]])
        way.append(near.argmin(axis=0) - 1)
        total = row + near.min(axis=0)
    column = int(total.argmin())
    path = [column]
    for step in reversed(way):
        column += int(step[column])
        path.append(column)
    return np.array(path[::-1])


def _blended(stack: np.ndarray, over: int, mask: np.ndarray, wraps: bool) -> np.ndarray:
    """Return (H, over, C) the right end under ``mask`` and the left end beside it, joined band by band."""
    pad = over if wraps else 0

    def smooth(image: np.ndarray, sigma: float) -> np.ndarray:
        wide = np.pad(image, ((pad, pad), (0, 0)), mode="wrap") if wraps else image
        return blurred(wide, sigma)[pad : pad + len(image)]

    widest = max(_WIDEST * over, _FINEST)
    sigmas = [_FINEST]
    while sigmas[-1] * 2 <= widest:
        sigmas.append(sigmas[-1] * 2)
    blend = np.empty((len(stack), over, stack.shape[-1]))
    masks = [smooth(mask, sigma) for sigma in sigmas]
    for channel in range(stack.shape[-1]):
        image = stack[..., channel]
        levels = [image, *(smooth(image, sigma) for sigma in sigmas)]
        bands = [fine - coarse for fine, coarse in zip(levels, levels[1:], strict=False)]
        total = masks[-1] * levels[-1][:, -over:] + (1 - masks[-1]) * levels[-1][:, :over]
        for band, share in zip(bands, masks, strict=True):
            total = total + share * band[:, -over:] + (1 - share) * band[:, :over]
        blend[..., channel] = total
    return blend


def _steps_over_wrap(stack: np.ndarray) -> float:
    """Return how visible the borders are where maps (N, N, C), in their scales, are repeated as they are."""
    shares = []
    for image in (stack, stack.swapaxes(0, 1)):
        border = np.abs(image[:, 0] - image[:, -1]).sum(axis=-1).mean()
        shares.append(border / max(np.abs(np.diff(image, axis=1)).sum(axis=-1).mean(), 1e-12))
    return float(np.mean(shares))


def _resized(image: np.ndarray, size: int) -> np.ndarray:
    """Return rows of ``size`` means of equal parts of a periodic image's rows (H, W, C)."""
    width = image.shape[1]
    sums = np.concatenate([np.zeros_like(image[:, :1]), image.cumsum(axis=1)], axis=1)
    at = np.arange(size + 1) * width / size
    low = np.minimum(at.astype(int), width - 1)
    part = (at - low)[None, :, None]
    edges = sums[:, low] * (1 - part) + sums[:, low + 1] * part
    return np.diff(edges, axis=1) * (size / width)
