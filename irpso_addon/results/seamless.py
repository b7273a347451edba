"""Makes a card's maps seamless: cuts all maps along one path through an overlap (Efros & Freeman 2001).

Blends the overlap by frequency bands, wide for low and narrow for high frequencies (Burt & Adelson 1983): no edge
of low frequencies at the path, and no loss of detail beside it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..core.errors import InputError
from ..core.filters import blurred
from ..reflectance.model import ReflectanceModel

_OVERLAPS = 0.2, 0.4  # of the side: range of the search
_ALIKE = 1.2  # of the least cost of a path: of overlaps up to this cost the smallest is chosen
_STRETCH = 0.03  # largest relative difference of the two periods
_SEARCHED = 256  # texels of a side in the first search for the overlap
_LEAST = 3  # texels of an overlap: a path runs through its middle
_MIN_SIDE = 32  # least texels of a side
_FREE = 0.3  # of the overlap at each side: the path avoids it
_FINEST, _WIDEST = 1.0, 1 / 20  # standard deviations of the blend's bands: texels, of the overlap; six are _FREE
_SMOOTH = 1.0  # texels: standard deviation of a blur of the path costs


@dataclass(frozen=True)
class Seamless:
    """values: parameter name → (N, N, components), periodic. crop: x, y and side of the square of the card in use, from
    the lower left. period: its columns and rows that repeat. seam: mean difference of neighbours across the paths,
    over that of all neighbours in this direction: 1 is no seam. plain: the same of the square without blending.
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
    """Return seamless maps of the largest square of covered texels. values: (H, W, components). covered: (H, W) bool.

    size: texels of a side, by default the largest power of two within the period; 0: those of the period, which may be
    oblong. overlap: fraction of the square's side that the blend consumes; by default the one whose ends match, so that
    a weave or a bond of bricks continues. Raises InputError if the square is too small.
    """
    x, y, side = largest_square(covered)
    if side < _MIN_SIDE or side * (1 - (overlap or 0)) < _MIN_SIDE // 2:
        raise InputError(f"the card's largest square without holes has {side} texels a side; {_MIN_SIDE} are needed")
    names = [parameter.name for parameter in model.parameters]
    square = {name: np.asarray(values[name], np.float64)[y : y + side, x : x + side] for name in names}
    stack = np.concatenate([square[name] for name in names], axis=-1)
    scale = np.concatenate([_scale(model, name, square[name]) for name in names])
    if overlap:
        over = above = min(max(round(overlap * side), _LEAST), side // 2)
    else:
        over, above = _matching_overlaps(stack / scale)
    plain = _steps_over_wrap(stack / scale)
    across, first = _joined(stack, scale, over, wraps=False)
    turned, second = _joined(across.swapaxes(0, 1), scale, above, wraps=True)
    whole = turned.swapaxes(0, 1)
    period = (side - over, side - above)
    seam = float(np.mean([first, second]))
    if size != 0:
        size = size or 2 ** int(np.log2(min(period)))
        whole = _resized(_resized(whole, size).swapaxes(0, 1), size).swapaxes(0, 1)
    result, at = {}, 0
    for parameter in model.parameters:
        part = whole[..., at : at + square[parameter.name].shape[-1]]
        at += part.shape[-1]
        if parameter.is_normal:
            part = part / np.maximum(np.linalg.norm(part, axis=-1, keepdims=True), 1e-9)
        result[parameter.name] = np.clip(part, *parameter.range).astype(np.float32)
    return Seamless(result, (x, y, side), period, seam, plain)


def largest_square(covered: np.ndarray) -> tuple[int, int, int]:
    """Return x, y and side of the largest square of covered texels (H, W), of several the one nearest the middle."""
    sums = np.pad(covered.astype(np.int64).cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))

    def squares(side: int) -> np.ndarray:
        """Return, for each texel as the lower left one, whether the square is covered."""
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
    """Return (components,) the unit of a map's differences: its standard deviation, at least 1 % of its range."""
    parameter = model.parameter(name)
    least = 0.01 * (2.0 if parameter.is_normal else float(np.ptp(parameter.range)))
    return np.full(values.shape[-1], max(float(values.std(axis=(0, 1)).mean()), least))


def _joined(stack: np.ndarray, scale: np.ndarray, over: int, wraps: bool) -> tuple[np.ndarray, float]:
    """Return maps (H, W − over, C) periodic along the rows, and the ``Seamless.seam`` of the path.

    wraps: whether the first row continues the last; then the path does, too.
    """
    cost = _path_costs(stack / scale, over, wraps)
    path = (over - cost.shape[1]) // 2 + cheapest_path(cost, wraps)
    mask = (np.arange(over) < path[:, None]).astype(np.float64)  # 1 for the right end
    blend = _blended(stack, over, mask, wraps)
    whole = np.concatenate([blend, stack[:, over:-over]], axis=1)
    rows = np.arange(len(whole))
    steps = np.abs(np.diff(whole / scale, axis=1)).sum(axis=-1)
    return whole, float(steps[rows, path - 1].mean() / steps.mean())


def _path_costs(stack: np.ndarray, over: int, wraps: bool) -> np.ndarray:
    """Return (H, W) squared differences of both ends of scaled maps where a path may run in their overlap."""
    cost = ((stack[:, :over] - stack[:, -over:]) ** 2).sum(axis=-1)
    cost = blurred(np.pad(cost, ((over, over), (0, 0)), mode="wrap"), _SMOOTH)[over:-over] if wraps else blurred(
        cost, _SMOOTH)  # fmt: skip
    free = min(round(_FREE * over), (over - 1) // 2)
    return cost[:, free : over - free]


def _matching_overlaps(stack: np.ndarray) -> tuple[int, int]:
    """Return the overlaps along rows and along columns, in texels, at which the ends of scaled maps (N, N, C) match.

    The two periods differ by _STRETCH at most. The search is coarse to fine: all overlaps in block means, then those
    beside the best in ever smaller blocks.
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
    """Return the means of blocks of step × step texels, without incomplete blocks at the end."""
    count = len(stack) // step
    return stack[: count * step, : count * step].reshape(count, step, count, step, -1).mean(axis=(1, 3))


def _best_beside(stack: np.ndarray, over: int) -> int:
    near = over + np.arange(-2, 3)
    return int(near[_least_costs(stack, near).argmin()])


def _least_costs(stack: np.ndarray, overlaps: np.ndarray) -> np.ndarray:
    """Return the mean cost of the cheapest path through each overlap along the rows."""
    costs = []
    for over in overlaps:
        cost = _path_costs(stack, int(over), wraps=False)
        costs.append(cost[np.arange(len(cost)), cheapest_path(cost)].mean())
    return np.array(costs)


def cheapest_path(cost: np.ndarray, wraps: bool = False) -> np.ndarray:
    """Return (H,) the columns of the path of least sum from the first row of costs (H, W) to the last.

    The path moves by at most one column from row to row; wraps: also from the last row to the first.
    """
    if wraps:  # start in the column of the middle one of three periods
        start = int(cheapest_path(np.concatenate([cost] * 3))[len(cost)])
        cost = cost.copy()
        cost[0, np.arange(cost.shape[1]) != start] = np.inf
        closed = cheapest_path(np.concatenate([cost, cost[:1]]))
        return closed[:-1]
    total, steps = cost[0], []
    for row in cost[1:]:
        padded = np.pad(total, 1, constant_values=np.inf)
        near = np.stack([padded[:-2], padded[1:-1], padded[2:]])
        steps.append(near.argmin(axis=0) - 1)
        total = row + near.min(axis=0)
    column = int(total.argmin())
    path = [column]
    for step in reversed(steps):
        column += int(step[column])
        path.append(column)
    return np.array(path[::-1])


def _blended(stack: np.ndarray, over: int, mask: np.ndarray, wraps: bool) -> np.ndarray:
    """Return (H, over, C) a blend, band by band, of the right end where ``mask`` is 1 and the left end elsewhere."""
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
    """Return the ``Seamless.seam`` of scaled maps (N, N, C) that are repeated without blending."""
    shares = []
    for image in (stack, stack.swapaxes(0, 1)):
        border = np.abs(image[:, 0] - image[:, -1]).sum(axis=-1).mean()
        shares.append(border / max(np.abs(np.diff(image, axis=1)).sum(axis=-1).mean(), 1e-12))
    return float(np.mean(shares))


def _resized(image: np.ndarray, size: int) -> np.ndarray:
    """Resample the rows of a periodic image (H, W, C) to ``size`` means of equal parts."""
    width = image.shape[1]
    sums = np.concatenate([np.zeros_like(image[:, :1]), image.cumsum(axis=1)], axis=1)
    at = np.arange(size + 1) * width / size
    low = np.minimum(at.astype(int), width - 1)
    part = (at - low)[None, :, None]
    edges = sums[:, low] * (1 - part) + sums[:, low + 1] * part
    return np.diff(edges, axis=1) * (size / width)
