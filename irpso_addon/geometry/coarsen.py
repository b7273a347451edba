"""Domains at half the resolution, and maps between the two resolutions.

A coarse texel stands for the covered texels among 2 × 2; an odd row or column ends in smaller cells.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..capture.bounds import bounded, weight_and_clipped
from .domain import Domain, GeometryBake, with_texels
from .samples import new_stack
from .seams.seams import SeamMap, seam_map

_SHORT = 1e-6  # length of a mean of unit vectors; shorter means have no direction, as on two sides of a thin wall
_OTHER_ISLAND = 1e-6  # weight of another island's coarse texel: matters only where no other is near
_NEAR, _FAR = 0.75, 0.25  # bilinear weights: a texel's centre lies a quarter of a coarse texel off its cell's


def coarser(domain: Domain, scratch: Path | None = None) -> Domain:
    """Return the domain at half the size, rounded up: radiance averaged by weight, the rest over covered texels.

    A sample's weight is the mean of its texels' weights. Where all of these are clipped, it is a lower bound, else the
    clipped ones do not count. scratch: folder of a mapped file for the samples, None for memory. Raises ValueError for
    a tile with a halo.
    """
    if any(domain.halo):
        raise ValueError("a tile with a halo has no coarser domain: its cells would differ from the whole domain's")
    x, y = domain.origin
    bake = _coarser_bake(domain.bake)
    height, width = bake.coverage.shape
    stack = new_stack(domain.observations, height, width, scratch)
    for observation, layer in enumerate(domain.stack.layers()):
        stack.put(observation, _coarser_layer(layer, domain.bake.coverage))
    seams = None if domain.seams is None else _coarser_seams(domain.seams, domain.bake.coverage)
    return replace(with_texels(domain, bake, stack.values, seams), origin=(x // 2, y // 2))


def coarser_map(domain: Domain, coarse: Domain, values: np.ndarray, normal: bool = False) -> np.ndarray:
    """Return (h, w, n) float32 means of a map (H, W, n) over covered texels.

    normal: the map holds unit normals in tangent frames; they are averaged in world space and normalised.
    """
    count = _cells(domain.bake.coverage).sum(axis=(1, 3))
    vectors = in_world(domain, values) if normal else np.asarray(values, np.float64)
    total = _cells(np.where(domain.bake.coverage[..., None], vectors, 0)).sum(axis=(1, 3))
    mean = total / np.maximum(count, 1)[..., None]
    return (in_frames(coarse, mean) if normal else mean).astype(np.float32)


def finer_map(
    coarse: Domain, domain: Domain, values: np.ndarray, otherwise: np.ndarray | float, normal: bool = False
) -> np.ndarray:
    """Return (H, W, n) float32: a map (h, w, n) of the coarse domain, interpolated between its solvable texels.

    otherwise: (H, W, n), or broadcastable to it, where no such texel is near. normal: as in ``coarser_map``.
    """
    vectors = in_world(coarse, values) if normal else np.asarray(values, np.float64)
    total = np.zeros((*domain.shape, vectors.shape[-1]))
    weights = np.zeros((*domain.shape, 1))
    for rows, down in _linear_weights(domain.shape[0], coarse.shape[0]):
        for columns, across in _linear_weights(domain.shape[1], coarse.shape[1]):
            weight = (down[:, None] * across * coarse.solvable[rows[:, None], columns])[..., None]
            if domain.seams is not None and coarse.seams is not None:
                own = coarse.seams.island[rows[:, None], columns] == domain.seams.island
                weight *= np.where(own, 1.0, _OTHER_ISLAND)[..., None]
            total += np.where(weight > 0, weight * vectors[rows[:, None], columns], 0)
            weights += weight
    mean = total / np.where(weights > 0, weights, 1)
    mean = in_frames(domain, mean) if normal else mean
    return np.where(weights > 0, mean, otherwise).astype(np.float32)


def in_world(domain: Domain, normals: np.ndarray) -> np.ndarray:
    """Return (H, W, 3) float64 world vectors of normals in tangent frames; a card's stay unchanged."""
    normals = np.asarray(normals, np.float64)
    return normals if domain.card else np.einsum("hwi,hwij->hwj", normals, domain.bake.frames())


def in_frames(domain: Domain, vectors: np.ndarray) -> np.ndarray:
    """Return (H, W, 3) float64 unit normals in tangent frames, of world vectors of any length.

    A vector below the tangent plane is projected onto it; a zero vector becomes the texel's own normal.
    """
    local = vectors if domain.card else np.einsum("hwj,hwij->hwi", vectors, domain.bake.frames())
    local = np.concatenate([local[..., :2], np.maximum(local[..., 2:], 0)], axis=-1)
    length = np.linalg.norm(local, axis=-1, keepdims=True)
    return np.where(length > _SHORT, local / np.maximum(length, _SHORT), (0.0, 0.0, 1.0))


def _cells(values: np.ndarray) -> np.ndarray:
    """Return (h, 2, w, 2, …) of (H, W, …): the 2 × 2 texels of each cell, padded with zeros."""
    height, width = values.shape[:2]
    padded = np.pad(values, [(0, height % 2), (0, width % 2)] + [(0, 0)] * (values.ndim - 2))
    return padded.reshape((height + 1) // 2, 2, (width + 1) // 2, 2, *values.shape[2:])


def _coarser_layer(layer: np.ndarray, coverage: np.ndarray) -> np.ndarray:
    weight, clipped = weight_and_clipped(np.where(coverage, layer[..., 3], 0))
    bound, weight = clipped.any(axis=-1), weight.astype(np.float64)
    mean, total = _cell_means(layer[..., :3], np.where(bound, 0, weight))
    least, total_bound = _cell_means(layer[..., :3], np.where(bound, weight, 0))
    # A cell without weight has the plain mean of the photographs, for display.
    plain, _ = _cell_means(layer[..., :3], coverage & np.isfinite(layer[..., :3]).all(axis=-1))
    exact = total[..., None] > 0
    mean = np.where(exact, mean, np.where(total_bound[..., None] > 0, least, plain))
    count = np.maximum(_cells(coverage).sum(axis=(1, 3)), 1)
    weights = bounded(np.where(total > 0, total, total_bound) / count, _cells(clipped).any(axis=(1, 3)) & ~exact)
    return np.concatenate([mean, weights[..., None]], axis=-1).astype(np.float32)


def _cell_means(radiance: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (h, w, 3) weighted means of the cells, 0 where no texel has weight, and (h, w) their weights."""
    # Values of weight 0 may be NaN, and 0 · NaN is NaN.
    weighted = np.where(weight[..., None] > 0, radiance, 0) * weight[..., None]
    total = _cells(weight).sum(axis=(1, 3))
    return _cells(weighted).sum(axis=(1, 3)) / np.where(total > 0, total, 1)[..., None], total


def _coarser_seams(seams: SeamMap, coverage: np.ndarray) -> SeamMap:
    """Return the seams at half the size: a coarse texel lies on the island of the first of its texels."""
    islands = _cells(np.where(coverage, seams.island + 1, 0)).transpose(0, 2, 1, 3)
    flat = islands.reshape(*islands.shape[:2], 4)
    first = (flat > 0).argmax(axis=-1)[..., None]
    return seam_map(seams.edges.halved(), np.take_along_axis(flat, first, axis=-1)[..., 0] - 1, seams.radius)


def _coarser_bake(bake: GeometryBake) -> GeometryBake:
    covered = _cells(bake.coverage)
    height, width = covered.shape[0], covered.shape[2]
    flat = covered.transpose(0, 2, 1, 3).reshape(height, width, 4)
    first = flat.argmax(axis=-1)[..., None, None]  # the cell's first covered texel, used where means fail

    def children(values: np.ndarray) -> np.ndarray:
        """(h, w, 4, n) float64: the texels of each cell."""
        cells = _cells(values.astype(np.float64)).transpose(0, 2, 1, 3, 4)
        return cells.reshape(height, width, 4, -1)

    def mean(values: np.ndarray, counted: np.ndarray) -> np.ndarray:
        counted = counted[..., None]
        return np.where(counted, values, 0).sum(axis=2) / np.maximum(counted.sum(axis=2), 1)

    def first_covered(values: np.ndarray) -> np.ndarray:
        return np.take_along_axis(values, first, axis=2)[:, :, 0]

    normals, tangents = children(bake.normal), children(bake.tangent)
    normal = _unit(mean(normals, flat), first_covered(normals))
    sign = first_covered(tangents)[..., 3:]
    same_frame = flat & (tangents[..., 3] == sign)  # a mirrored neighbour's tangent would be another frame's
    tangent = _orthogonal(mean(tangents[..., :3], same_frame), first_covered(tangents)[..., :3], normal)
    return GeometryBake(
        mean(children(bake.position), flat).astype(np.float32), normal.astype(np.float32),
        np.concatenate([tangent, sign], axis=-1).astype(np.float32), flat.any(axis=-1),
        mean(children(bake.uv), flat).astype(np.float32),
    )  # fmt: skip


def _orthogonal(tangent: np.ndarray, otherwise: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Return the unit vectors perpendicular to the normal that are nearest to the tangent (Gram–Schmidt)."""
    result = tangent - (tangent * normal).sum(axis=-1, keepdims=True) * normal
    second = otherwise - (otherwise * normal).sum(axis=-1, keepdims=True) * normal
    axis = np.eye(3)[np.abs(normal).argmin(axis=-1)]
    third = axis - (axis * normal).sum(axis=-1, keepdims=True) * normal
    return _unit(result, _unit(second, third))


def _unit(vectors: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
    """Return unit vectors; too short ones are replaced by the others, also normalised."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    others = np.linalg.norm(otherwise, axis=-1, keepdims=True)
    return np.where(
        length > _SHORT, vectors / np.maximum(length, _SHORT), otherwise / np.maximum(others, np.finfo(float).tiny)
    )


def _linear_weights(size: int, coarse: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield, for each texel of an axis, the index and bilinear weight of its own cell, then of the next cell."""
    at = np.arange(size)
    yield at // 2, np.full(size, _NEAR)
    other = at // 2 + np.where(at % 2 == 0, -1, 1)
    inside = (other >= 0) & (other < coarse)
    yield np.clip(other, 0, coarse - 1), np.where(inside, _FAR, 0.0)
