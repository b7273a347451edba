"""Input and output of every peer: Problem and PeerResult."""

from __future__ import annotations

import resource
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from irpso_addon.geometry.domain import Domain

Values = dict[str, np.ndarray]


@dataclass(frozen=True)
class Problem:
    """One capture of T texels under K distant lights, seen by one camera.

    radiance: (K, T, 3) float64. weights: (K, T), 0 for invalid samples, else 1. lights: (K, 3) unit
    directions toward the lights, in the frame of the normals. intensities: (K, 3). views: (T, 3) unit directions
    toward the camera. texels: (T, 2) row and column in the card. model: name of a shipped reflectance model. truth:
    parameter → (T, components), for measuring alone.
    """

    radiance: np.ndarray
    weights: np.ndarray
    lights: np.ndarray
    intensities: np.ndarray
    views: np.ndarray
    texels: np.ndarray
    model: str
    truth: Mapping[str, np.ndarray] | None = None

    @property
    def count(self) -> int:
        """T, the number of texels."""
        return self.radiance.shape[1]

    @property
    def grey(self) -> np.ndarray:
        """(K, T): mean over RGB of radiance over the light's intensity, 0 where the weight is 0."""
        lit = self.intensities > 0  # a coloured light may have none of a channel
        shades = self.radiance / np.where(lit, self.intensities, np.inf)[:, None]
        return self.weights * shades.sum(axis=-1) / lit.sum(axis=-1)[:, None]

    def scale(self, percentile: float = 80.0) -> np.ndarray:
        """Return (T,), each texel's brightness: the percentile of its samples with weight; 1 if it has none."""
        ordered = np.sort(np.where(self.weights > 0, self.grey, np.inf), axis=0)
        brightness = percentile_of(ordered, (self.weights > 0).sum(axis=0), percentile)
        return np.where((brightness > 0) & np.isfinite(brightness), brightness, 1.0)

    def subset(self, texels: Sequence[int] | np.ndarray) -> Problem:
        """Return the problem with only some texels, by index."""
        chosen = np.asarray(texels, np.intp)
        truth = None if self.truth is None else {name: value[chosen] for name, value in self.truth.items()}
        return replace(
            self, radiance=self.radiance[:, chosen], weights=self.weights[:, chosen], views=self.views[chosen],
            texels=self.texels[chosen], truth=truth,
        )  # fmt: skip


@dataclass(frozen=True)
class Sample:
    """A point of a peer's trace: seconds, evaluations a texel, and the best values so far."""

    seconds: float
    evaluations: float
    values: Values


@dataclass(frozen=True)
class PeerResult:
    """A peer's result.

    name: of the method. values: parameter → (T, components). evaluations: (T,) renders of all observations of a texel,
    where a forward and backward pass counts as ``GRADIENT_EVALUATIONS``. seconds: of the whole run. memory_mb: peak of
    the process's resident memory since it began, in MB. settings: of the method. trace: may be empty.
    """

    name: str
    values: Values
    evaluations: np.ndarray
    seconds: float
    memory_mb: float
    settings: dict[str, object] = field(default_factory=dict)
    trace: tuple[Sample, ...] = ()


def problem_of(domain: Domain, model: str, truth: Mapping[str, np.ndarray] | None = None) -> Problem:
    """Return the solvable texels of a card's domain as a problem; truth: parameter → (H, W, components).

    Raises ValueError for near lights, several cameras, or a mesh, which the peers do not support.
    """
    one_view = (domain.views == domain.views[0]).all()
    if not domain.card or domain.lights[:, 3].any() or not one_view:
        raise ValueError("peers solve flat cards under distant lights, seen by one camera")
    rows, columns = np.nonzero(domain.solvable)
    stack = domain.stack.texels(rows, columns).astype(np.float64)
    view = np.broadcast_to(domain.views[0, :3].astype(np.float64), (len(rows), 3))
    if domain.views[0, 3]:
        view = view - domain.bake.position[rows, columns]
    lights = domain.lights[:, :3].astype(np.float64)
    weights = (stack[..., 3] > 0).astype(np.float64)
    return Problem(
        radiance=np.where(stack[..., 3:] > 0, stack[..., :3], 0),
        weights=weights,
        lights=lights / np.linalg.norm(lights, axis=-1, keepdims=True),
        intensities=domain.intensities.astype(np.float64),
        views=view / np.linalg.norm(view, axis=-1, keepdims=True),
        texels=np.stack([rows, columns], axis=-1),
        model=model,
        truth=None if truth is None else {name: np.asarray(v)[rows, columns] for name, v in truth.items()},
    )


def angles(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return (T,) degrees between vectors (T, 3) of any length; atan2 is precise for small angles."""
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(axis=-1)))


def percentile_of(ordered: np.ndarray, count: np.ndarray, percentile: float) -> np.ndarray:
    """Return (T,) percentiles of the first ``count`` of each ascending column of (K, T), linear between ranks."""
    last = np.maximum(count - 1, 0)
    rank = last * percentile / 100
    low = np.floor(rank).astype(int)
    columns = np.arange(ordered.shape[1])
    a, b = ordered[low, columns], ordered[np.minimum(low + 1, last), columns]
    return a + np.where(rank > low, b - a, 0) * (rank - low)


def peak_memory_mb() -> float:
    """Return the peak resident memory of this process, in MB."""
    unit = 2**20 if sys.platform == "darwin" else 2**10  # ru_maxrss is in bytes on macOS, in KiB on Linux
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit
