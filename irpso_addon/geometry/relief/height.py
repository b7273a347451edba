"""Heights from normals: weighted least-squares integration of slopes, with the natural boundary at the mask.

The discrete problem is from Quéau, Durou & Aujol 2018, Normal Integration: A Survey: minimise, over the edges inside
the mask, the weighted squares of height difference minus mean slope. The solver is conjugate gradients, preconditioned
by the Poisson equation of the full rectangle, which a cosine transform inverts: the number of steps does not grow with
the size. It ends at 1e-4 of the first residual, or after 300 steps.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass

import numpy as np

from ...core.graph import connected
from ...core.steps import blocking

# A slope's error grows with the inverse square of nz, so the optimal weight is its fourth power. On the normals of a
# scanned bunny with 2° of noise the square is as accurate (0.08 texels of 102), in a fifth of the steps.
_MIN_NZ, _POWER = 0.1, 2
_TOLERANCE, _STEPS = 1e-4, 300
TEXELS = "texels"  # unit of a card's heights: the width of a texel


@dataclass(frozen=True)
class Height:
    """A relief. values: (H, W) float32, toward the normal, mean 0 in every island, 0 outside. covered: (H, W) bool.

    unit: "texels" (the width of a card's texel) or "world". steps: of the solver.
    """

    values: np.ndarray
    covered: np.ndarray
    unit: str
    steps: int = 0

    @property
    def midlevel(self) -> float:
        """The PNG value, 0…1, of height 0."""
        low, high = self._limits
        return -low / (high - low)

    @property
    def scale(self) -> float:
        """The height range of the PNG's 0…1, in ``unit``."""
        low, high = self._limits
        return high - low

    @property
    def _limits(self) -> tuple[float, float]:
        inside = self.values[self.covered]
        low, high = (float(inside.min()), float(inside.max())) if inside.size else (0.0, 0.0)
        return (low, high) if high > low else (low, low + 1.0)

    def described(self) -> dict[str, object]:
        """Return the relief's table for the report."""
        return {"unit": self.unit, "scale": self.scale, "midlevel": self.midlevel, "steps": self.steps}


def card_slopes(
    normals: np.ndarray, focal: tuple[float, float] = (1.0, 1.0), rays: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return slopes (H, W, 2) of a card's relief along x and y, in texels per texel, and their weights (H, W).

    normals: (H, W, 3) in camera space. focal: the camera's scale along x and y; a texel is 1 / focal[0] wide. Without
    ``rays`` the camera is orthographic. rays: (H, W, 3) points at depth 1 in a perspective camera's pixels; the slopes
    are then of −log depth times focal[0] (Quéau, Durou & Aujol 2018, Section 2.3), and ``relief_from_log`` converts
    the integrated result.
    """
    facing = normals[..., 2] if rays is None else -np.einsum("hwi,hwi->hw", normals, rays)
    # The slope of a surface that turns away is infinite.
    steep = np.maximum(facing, _MIN_NZ)
    return -normals[..., :2] / steep[..., None] * (1.0, focal[0] / focal[1]), np.minimum(steep, 1) ** _POWER


def relief_from_log(values: np.ndarray, focal: float) -> np.ndarray:
    """Return heights from −focal · log(depth / D), in texels as wide as at the mean depth D."""
    return -focal * np.expm1(-np.asarray(values) / focal)


def tangent_slopes(normals: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return slopes (H, W, 2) of the relief on a mesh, in world units per texel, and their weights (H, W).

    normals: (H, W, 3) in the solver's tangent frames. along: (H, W, 2, 2) one texel's step along x and y, in tangent
    and bitangent components, world units.
    """
    steep = np.maximum(normals[..., 2], _MIN_NZ)
    return np.einsum("hwki,hwi->hwk", along, -normals[..., :2] / steep[..., None]), steep**_POWER


def integrate_steps(
    slopes: np.ndarray, weights: np.ndarray, covered: np.ndarray, torn: np.ndarray | None = None
) -> Generator[None, None, tuple[np.ndarray, int]]:
    """Return heights (H, W) float64, with mean 0 in every connected island and 0 outside, and the number of steps.

    slopes: (H, W, 2) along x and y per texel. weights: (H, W) ≥ 0. covered: (H, W) bool. torn: (H, W, 2) bool, true
    where a texel and its neighbour at x + 1, or at y + 1, are not neighbours on the surface.
    """
    edges = []
    for axis, step in ((1, 0), (0, 1)):
        here, there = _pair(covered.shape, axis)
        joined = covered[here] & covered[there]
        if torn is not None:
            joined &= ~torn[here][..., step]
        weight = np.where(joined, 2 / (1 / np.maximum(weights[here], 1e-30) + 1 / np.maximum(weights[there], 1e-30)), 0)
        slope = 0.5 * (slopes[here][..., step].astype(np.float64) + slopes[there][..., step])
        edges.append((axis, weight, np.where(joined, slope, 0.0)))
    largest = max((weight.max(initial=0) for _, weight, _ in edges), default=0)
    if not largest > 0:
        return np.zeros(covered.shape), 0
    edges = [(axis, weight / largest, slope) for axis, weight, slope in edges]
    heights, steps = yield from _conjugate_gradients(edges, covered.shape)
    label = islands(covered.shape, [(axis, weight > 0) for axis, weight, _ in edges])
    count = np.maximum(np.bincount(label[covered]), 1)
    mean = np.bincount(label[covered], heights[covered]) / count
    return np.where(covered, heights - mean[np.where(covered, label, 0)], 0.0), steps


integrate = blocking("integrate", integrate_steps)


def islands(shape: tuple[int, ...], joined: list[tuple[int, np.ndarray]]) -> np.ndarray:
    """Return (H, W) int island numbers; a texel without connected neighbours is an island of its own.

    joined: bool per axis, (H, W − 1) for axis 1 and (H − 1, W) for axis 0: neighbours are connected.
    """
    number = np.arange(shape[0] * shape[1]).reshape(shape)
    ends = [(number[_pair(shape, axis)[0]][joins], number[_pair(shape, axis)[1]][joins]) for axis, joins in joined]
    first, second = (np.concatenate(part) for part in zip(*ends, strict=True))
    return connected(number.size, first, second).reshape(shape)


def _pair(shape: tuple[int, ...], axis: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Return slices of the texels with a neighbour along an axis, and of those neighbours."""
    if axis == 1:
        return (slice(None), slice(0, shape[1] - 1)), (slice(None), slice(1, shape[1]))
    return (slice(0, shape[0] - 1), slice(None)), (slice(1, shape[0]), slice(None))


def _conjugate_gradients(edges: list, shape: tuple[int, ...]) -> Generator[None, None, tuple[np.ndarray, int]]:
    """Return the least-squares heights and the number of steps. Texels without an edge keep their values."""

    def divergence(flows: list[np.ndarray]) -> np.ndarray:
        total = np.zeros(shape)
        for (axis, _, _), flow in zip(edges, flows, strict=True):
            here, there = _pair(shape, axis)
            total[here] -= flow
            total[there] += flow
        return total

    def operator(z: np.ndarray) -> np.ndarray:
        return divergence([weight * np.diff(z, axis=axis) for axis, weight, _ in edges])

    residual = divergence([weight * slope for _, weight, slope in edges])
    heights = np.zeros(shape)
    invert = _poisson(shape)
    preconditioned = invert(residual)
    direction, product = preconditioned, float((residual * preconditioned).sum())
    first, step = product, 0
    while step < _STEPS and product > _TOLERANCE**2 * first:
        yield
        applied = operator(direction)
        length = product / float((direction * applied).sum())
        heights += length * direction
        residual -= length * applied
        preconditioned = invert(residual)
        product, before = float((residual * preconditioned).sum()), product
        direction = preconditioned + (product / before) * direction
        step += 1
    return heights, step


def _poisson(shape: tuple[int, ...]) -> Callable[[np.ndarray], np.ndarray]:
    """Return a solver of the Poisson equation on the rectangle with reflecting borders; its result has mean 0."""
    y, x = (2 - 2 * np.cos(np.pi * np.arange(size) / size) for size in shape)
    eigenvalues = y[:, None] + x[None]
    eigenvalues[0, 0] = np.inf

    def solve(right: np.ndarray) -> np.ndarray:
        return _cosines(_cosines(_cosines(_cosines(right, 1), 0) / eigenvalues, 0, True), 1, True)

    return solve


def _cosines(values: np.ndarray, axis: int, inverse: bool = False) -> np.ndarray:
    """Return the type II cosine transform along an axis, or its inverse, by a real FFT (Makhoul 1980)."""
    values = np.moveaxis(values, axis, -1)
    size = values.shape[-1]
    half = size // 2 + 1
    turn = np.exp(-0.5j * np.pi * np.arange(half) / size)
    result = np.empty_like(values, np.float64)
    if not inverse:
        ordered = np.concatenate([values[..., ::2], values[..., 1::2][..., ::-1]], axis=-1)
        turned = np.fft.rfft(ordered, axis=-1) * turn
        result[..., :half] = turned.real
        result[..., half:] = -turned.imag[..., size - half : 0 : -1]
    else:
        mirrored = np.zeros((*values.shape[:-1], half))
        mirrored[..., 1:] = values[..., : size - half : -1]
        ordered = np.fft.irfft((values[..., :half] - 1j * mirrored) / turn, size, axis=-1)
        result[..., ::2] = ordered[..., : (size + 1) // 2]
        result[..., 1::2] = ordered[..., (size + 1) // 2 :][..., ::-1]
    return np.moveaxis(result, -1, axis)
