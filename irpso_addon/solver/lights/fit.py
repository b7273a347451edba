"""One Gauss–Newton step on the light parameters, with the texel parameters eliminated (Golub and Pereyra 1973)."""

from __future__ import annotations

from collections.abc import Generator, Mapping
from contextlib import closing
from dataclasses import dataclass

import numpy as np

from ...core.errors import InputError
from ...geometry.domain import Domain
from ...geometry.spaces import unit
from ...reflectance.model import ReflectanceModel
from ..settings.groups import Fitness
from ..state.prepare import Texels, drop_shadow, light_vectors
from ..views.forward import Renderer

GAINS, MOVES = 3, 3  # free parameters of a light: log intensities, and angles (a near light's third: its distance)
_TURN = 2e-3  # radians, of a normal or a light: small against the width of a highlight, large against float32
_STEP = 2e-3  # of a parameter's range
_GAIN_PRIOR = 2.0  # standard deviation of a logarithm: weak, it only fixes undetermined gains
_GROUPS = 8  # of texels, for the deviations
_MAX_STEP = 0.5  # of a logarithm
_FAR, _DARKEST = 0.7, 0.05  # above this log error, a factor of two, shadows and highlights are not detected
# Factor on the deviations of a common rotation, because all texels share the model's errors. With 1, the lights of
# bunny_specular and glaze end 0.5 and 0.2° farther off, with 4 those of metal paint 0.5°.
_MODEL_ERROR = 2.0
_SAMPLED_AS = 100.0  # independent texels: errors of neighbours are correlated, so more texels add no information


@dataclass(frozen=True)
class LightStep:
    """gains: (K, 3) log intensities to add. moves: (K, 3) radians, or fractions of the distance, along ``axes_of``.

    deviations: (K, 3) standard deviations of the gains (delete-a-group jackknife of the texels; Efron 1982).
    determined: second smallest eigenvalue of the gains' normalised matrix: 1 where the shading of every light is known,
    near 0 where all texels face one way and so do not determine the gains. explained: the fraction of the
    weighted squared error that the step removes. rotation: (3, 3) covariance, radians², of a rotation of all lights and
    normals about x, y and z, by highlights, with the moves' prior on it once, not once a light; zero for fixed lights.
    """

    gains: np.ndarray
    moves: np.ndarray
    deviations: np.ndarray
    determined: float
    explained: float
    rotation: np.ndarray


@dataclass(frozen=True)
class Moving:
    """Moves of lights. start: (K, 4) initial lights. axes: their ``axes_of``. moves: (K, 3) so far, along the axes.

    sigma: prior standard deviation of the moves, in radians and as a fraction of a near light's distance.
    """

    start: np.ndarray
    axes: np.ndarray
    moves: np.ndarray
    sigma: float

    def lights(self, further: np.ndarray | float = 0.0) -> np.ndarray:
        """Return (K, 4) float32 lights, moved ``further`` (K, 3) along their axes; directions stay unit."""
        result = self.start.astype(np.float64)
        result[:, :3] += np.einsum("ka,kac->kc", self.moves + further, self.axes)
        distant = self.start[:, 3] == 0
        result[distant, :3] /= np.linalg.norm(result[distant, :3], axis=-1, keepdims=True)
        return result.astype(np.float32)


def axes_of(domain: Domain) -> np.ndarray:
    """Return (K, 3, 3) axes of motion as rows: two across, the third toward the light (zero for a distant one).

    Unit vectors for a distant light; for a near one their length is its distance from the centre of the texels.
    """
    vectors = domain.lights[:, :3].astype(np.float64)
    near = domain.lights[:, 3] > 0
    middle = domain.bake.position[domain.bake.coverage].mean(axis=0, dtype=np.float64)
    toward = vectors - np.where(near[:, None], middle, 0.0)
    length = np.linalg.norm(toward, axis=-1, keepdims=True)
    toward /= length
    first, second = _perpendicular(toward)
    axes = np.stack([first, second, np.where(near[:, None], toward, 0.0)], axis=1)
    return axes * np.where(near[:, None], length, 1.0)[:, None]


def light_step(
    domain: Domain,
    model: ReflectanceModel,
    values: Mapping[str, np.ndarray],
    fixed: frozenset[str],
    scale: np.ndarray,
    fitness: Fitness,
    gains: bool,
    moving: Moving | None,
) -> Generator[None, None, LightStep]:
    """Yield after each observation; return the step of the lights toward a better fit.

    Variable projection (Golub and Pereyra 1973) eliminates the texels' free parameters, all of ``values`` but the
    ``fixed``: light errors that the texels have absorbed still count. Samples are weighted as in the robust fitness,
    but with the same δ in highlights.
    scale: (h, w) from ``prepare.texel_scale``. moving: None for fixed light positions.
    """
    rows, columns = texels = _covered(domain)
    steps = _texel_steps(model, values, fixed)
    equations = _Equations(domain.observations, len(rows), len(steps), gains, moving)
    renders = _Renders(domain, model, values, steps, moving)
    stack = np.stack([*domain.stack.layers()])
    drop_shadow(stack, domain.lights, domain.intensities, domain.bake.position, scale, fitness)
    _, irradiance = light_vectors(domain, texels)
    level = scale[texels][:, None] * float(irradiance.mean())
    far: dict[int, np.ndarray] = {}
    try:
        for k in range(domain.observations):
            render, texel_part, move_part = renders.of(k)
            samples = stack[k, rows, columns].astype(np.float64)
            difference = _difference(samples, render)
            outlying = difference
            if gains:
                # Relative to the error of most texels: a wrong intensity of the whole light is no outlier.
                outlying = difference - render * _median_ratio(difference, render, samples[:, 3:])
                logarithms = _log_factors(domain.stack.layer(k)[texels].astype(np.float64), render)
                if abs(logarithms.mean()) > _FAR:
                    far[k] = logarithms
            weight = samples[:, 3:] * (k not in far) / (1 + (outlying / level / fitness.delta) ** 2)
            equations.add(
                difference / level, weight, render / level, texel_part / level[..., None],
                None if move_part is None else move_part / level[..., None],
            )  # fmt: skip
            yield
    finally:
        renders.close()
    step = equations.solved(steps)
    for k, logarithms in far.items():
        step.gains[k] = logarithms
    return step


@dataclass(frozen=True)
class _Step:
    """A free parameter of all texels: values one step up and down, sum of both steps, and spread of its prior."""

    name: str
    up: np.ndarray
    down: np.ndarray
    width: np.ndarray
    spread: float


def _texel_steps(model: ReflectanceModel, values: Mapping[str, np.ndarray], fixed: frozenset[str]) -> list[_Step]:
    steps = []
    for parameter in model.parameters:
        if parameter.name in fixed:
            continue
        value = values[parameter.name]
        shape = value.shape[:2]
        if parameter.is_normal:
            for axis in _perpendicular(value.astype(np.float64)):
                up, down = (unit(value + side * _TURN * axis).astype(np.float32) for side in (1, -1))
                steps.append(_Step(parameter.name, up, down, np.full(shape, 2 * _TURN), 1.0))
            continue
        low, high = parameter.range
        extent = high - low
        for c in range(parameter.components):
            up, down = value.copy(), value.copy()
            up[..., c] = np.minimum(value[..., c] + _STEP * extent, high)
            down[..., c] = np.maximum(value[..., c] - _STEP * extent, low)
            width = (up - down)[..., c].astype(np.float64)
            steps.append(_Step(parameter.name, up, down, np.maximum(width, 1e-9), extent))
    return steps


class _Renders:
    """Renders of the texels: at the estimates, with each parameter a step up and down, and with each light moved."""

    def __init__(
        self,
        domain: Domain,
        model: ReflectanceModel,
        values: Mapping[str, np.ndarray],
        steps: list[_Step],
        moving: Moving | None,
    ):
        self._texels, self._shader = _covered(domain), model.shader
        self._shape, self._count = domain.shape, domain.observations
        self._widths = np.stack([step.width[self._texels] for step in steps], axis=-1) if steps else None
        changed = [{}, *({step.name: side} for step in steps for side in (step.up, step.down))]
        stacked = {
            p.name: np.concatenate([{**values, **change}[p.name] for change in changed]) for p in model.parameters
        }
        bake = domain.bake.map_arrays(lambda array: np.tile(array, (len(changed), *(1,) * (array.ndim - 1))))
        self._stepped = Renderer(bake, model, stacked, domain.lights, domain.intensities, domain.views, domain.card)
        self._moved = None
        if moving is not None:
            sides = [side * _TURN * np.eye(MOVES)[axis] for axis in range(MOVES) for side in (1, -1)]
            lights = np.concatenate([moving.lights(side) for side in sides])
            intensities, views = (np.tile(table, (2 * MOVES, 1)) for table in (domain.intensities, domain.views))
            self._moved = Renderer(domain.bake, model, values, lights, intensities, views, domain.card)

    def of(self, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Return observation k's radiance (T, 3), and the derivatives by parameters (T, 3, P) and light (T, 3, 3).

        Raises InputError where the model's radiance is not finite.
        """
        rows, columns = self._texels
        images = self._stepped.render(k)[..., :3].astype(np.float64).reshape(-1, *self._shape, 3)[:, rows, columns]
        if not np.isfinite(images).all():
            raise InputError(
                f"{self._shader}: its radiance is not finite for some materials in the parameters' ranges and lights of"
                " the capture; guard its divisions, roots and powers"
            )
        differences = (images[1::2] - images[2::2]).transpose(1, 2, 0)
        texel_part = differences / self._widths[:, None] if self._widths is not None else differences
        if self._moved is None:
            return images[0], texel_part, None
        renders = [self._moved.render(s * self._count + k)[..., :3].astype(np.float64) for s in range(2 * MOVES)]
        sides = np.stack([render[self._texels] for render in renders], axis=-1)
        return images[0], texel_part, (sides[..., ::2] - sides[..., 1::2]) / (2 * _TURN)

    def close(self) -> None:
        self._stepped.close()
        if self._moved is not None:
            self._moved.close()


class _Equations:
    """Normal equations of texel and light parameters, accumulated observation by observation.

    free: P, the free parameters of a texel.
    """

    def __init__(self, observations: int, texels: int, free: int, gains: bool, moving: Moving | None):
        self._groups = np.arange(texels) % _GROUPS
        self._gains, self._moving = gains, moving
        self._size = GAINS * gains + MOVES * (moving is not None)
        self._own: list[np.ndarray] = []  # (T, Q, Q) of each light, Q parameters
        self._right: list[np.ndarray] = []  # (T, Q)
        self._cross: list[np.ndarray] = []  # (T, P, Q)
        self._texel = np.zeros((texels, free, free))
        self._texel_right = np.zeros((texels, free))
        self._squares = self._weights = 0.0
        self._observations = observations

    def add(
        self,
        error: np.ndarray,
        weight: np.ndarray,
        render: np.ndarray,
        texel_part: np.ndarray,
        move_part: np.ndarray | None,
    ) -> None:
        """Add one observation: (T, 3) error, weight and render, (T, 3, P) and (T, 3, 3) derivatives."""
        gains = render[..., None] * np.eye(GAINS) if self._gains else None
        lights = np.concatenate([part for part in (gains, move_part) if part is not None], axis=-1)
        weighted = texel_part * weight[..., None]
        self._own.append(np.einsum("tcq,tcr,tc->tqr", lights, lights, weight, optimize=True))
        self._right.append(np.einsum("tcq,tc->tq", lights, weight * error))
        self._cross.append(np.einsum("tcp,tcq->tpq", weighted, lights))
        self._texel += np.einsum("tcp,tcr->tpr", weighted, texel_part)
        self._texel_right += np.einsum("tcp,tc->tp", weighted, error)
        self._squares += float((weight * error**2).sum())
        self._weights += float(weight.sum())

    def solved(self, steps: list[_Step]) -> LightStep:
        """Eliminate the texels and solve for the lights: with all texels, and without each group."""
        noise = max(self._squares / max(self._weights, 1.0), 1e-8)
        matrices, rights = self._reduced(steps, noise)
        count = self._observations
        whole = matrices.sum(axis=0)
        prior, prior_right = self._prior(noise)
        solutions = []
        for left_out in (None, *range(_GROUPS)):
            matrix, right = whole, rights.sum(axis=0)
            if left_out is not None:
                matrix, right = whole - matrices[left_out], right - rights[left_out]
            solutions.append(np.linalg.solve(matrix + prior, right + prior_right).reshape(count, self._size))
        solution, parts = solutions[0], np.stack(solutions[1:])
        spread = np.sqrt((_GROUPS - 1) / _GROUPS * ((parts - parts.mean(axis=0)) ** 2).sum(axis=0))
        zeros = np.zeros((count, GAINS))
        gains, deviations = (a[:, :GAINS] if self._gains else zeros for a in (solution, spread))
        moves = solution[:, self._size - MOVES :] if self._moving is not None else zeros
        return LightStep(
            np.clip(gains, -_MAX_STEP, _MAX_STEP), moves, deviations,
            self._determined(whole) if self._gains else 1.0,
            float(solution.ravel() @ rights.sum(axis=0)) / max(self._squares, 1e-30),
            np.zeros((3, 3)) if self._moving is None else self._rotation(self._moving, whole + prior, noise),
        )  # fmt: skip

    def _reduced(self, steps: list[_Step], noise: float) -> tuple[np.ndarray, np.ndarray]:
        """Return (G, KQ, KQ) and (G, KQ): the lights' equations without the texels, per group of texels."""
        count, size = self._observations, self._size
        texels = len(self._groups)
        own, right = np.stack(self._own, axis=1), np.stack(self._right, axis=1)
        cross = np.stack(self._cross, axis=2).reshape(texels, -1, count * size)
        if steps:
            precision = np.array([noise / step.spread**2 for step in steps])
            gram = self._texel + np.eye(len(steps)) * (precision + 1e-9 * np.einsum("tpp->tp", self._texel)[:, None])
            root = np.linalg.inv(np.linalg.cholesky(gram))
            cross, texel_right = root @ cross, np.einsum("tpr,tr->tp", root, self._texel_right)
        matrices = np.zeros((_GROUPS, count * size, count * size))
        rights = np.zeros((_GROUPS, count * size))
        for group in range(_GROUPS):
            chosen = self._groups == group
            blocks = matrices[group].reshape(count, size, count, size)
            blocks[np.arange(count), :, np.arange(count)] = own[chosen].sum(axis=0)
            rights[group] = right[chosen].sum(axis=0).ravel()
            if steps:
                part = cross[chosen].reshape(-1, count * size)
                matrices[group] -= part.T @ part
                rights[group] -= part.T @ texel_right[chosen].ravel()
        return matrices, rights

    def _strength(self, noise: float) -> float:
        """Return the weighted squared error that stands for one unit of −2 log probability."""
        return noise * max(1.0, len(self._groups) / _SAMPLED_AS)

    def _prior(self, noise: float) -> tuple[np.ndarray, np.ndarray]:
        """Return (KQ, KQ) and (KQ,): the prior's equations; gains keep the scale of each channel."""
        count, size = self._observations, self._size
        matrix, right = np.zeros((count * size,) * 2), np.zeros(count * size)
        strength = self._strength(noise)
        if self._gains:
            for channel in range(GAINS):
                of = np.arange(count) * size + channel
                matrix[of, of] += strength / _GAIN_PRIOR**2
                matrix[np.ix_(of, of)] += self._weights / count**2
        if self._moving is not None:
            precision = strength / self._moving.sigma**2
            for axis in range(MOVES):
                of = np.arange(count) * size + size - MOVES + axis
                matrix[of, of] += precision
                right[of] -= precision * self._moving.moves[:, axis]
        return matrix, right

    def _rotation(self, moving: Moving, matrix: np.ndarray, noise: float) -> np.ndarray:
        """Return the covariance of the lights' common rotation. matrix: (KQ, KQ) of their equations with the prior."""
        count, size = self._observations, self._size
        axes = unit(moving.axes[:, :2])
        by_angle = np.cross(np.cross(axes[:, 0], axes[:, 1])[:, None], axes).reshape(-1, 3)  # moves by rotation angles
        across = (np.arange(count)[:, None] * size + size - MOVES + np.arange(2)).ravel()
        common = np.linalg.qr(by_angle)[0]
        matrix[np.ix_(across, across)] -= self._strength(noise) / moving.sigma**2 * (1 - 1 / count) * common @ common.T
        angles = np.zeros((3, count * size))  # of the rotation, by the lights' parameters
        angles[:, across] = np.linalg.pinv(by_angle)
        covariance: np.ndarray = _MODEL_ERROR**2 * self._strength(noise) * angles @ np.linalg.solve(matrix, angles.T)
        return covariance

    def _determined(self, whole: np.ndarray) -> float:
        """Return the second smallest eigenvalue of the grey gains' matrix, normalised by its diagonal."""
        count, size = self._observations, self._size
        blocks = whole.reshape(count, size, count, size)[:, :GAINS, :, :GAINS].sum(axis=(1, 3))
        spread = np.sqrt(np.maximum(np.diag(blocks), 1e-30))
        return float(np.linalg.eigvalsh(blocks / np.outer(spread, spread))[min(1, count - 1)])


def _difference(samples: np.ndarray, render: np.ndarray) -> np.ndarray:
    """Return (T, 3): samples (T, 4) minus render, 0 at weight 0."""
    return np.where(samples[:, 3:] > 0, samples[:, :3] - render, 0.0)


def _log_factors(samples: np.ndarray, render: np.ndarray) -> np.ndarray:
    """Return (3,) log factors between most samples (T, 4) and their render, if no sample lies in shadow."""
    return np.log(np.maximum(1 + _median_ratio(_difference(samples, render), render, samples[:, 3:]), _DARKEST))


def brightened(domain: Domain, model: ReflectanceModel, values: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return (K, 3) factors on the intensities that match most samples of the texels."""
    texels = _covered(domain)
    factors = np.ones((domain.observations, GAINS))
    lit = domain.lights, domain.intensities, domain.views
    with closing(Renderer(domain.bake, model, values, *lit, domain.card)) as renderer:
        for k in range(domain.observations):
            render, seen = (a[texels].astype(np.float64) for a in (renderer.render(k)[..., :3], domain.stack.layer(k)))
            difference = _difference(seen, render)
            factors[k] = np.maximum(1 + _median_ratio(difference, render, seen[:, 3:]), 1e-3)
    return factors


def _median_ratio(difference: np.ndarray, render: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return (3,): medians of differences (T, 3) relative to the render, weighted by the render."""
    values, weight = difference / np.maximum(render, 1e-9), np.maximum(render, 0) * weight
    order = np.argsort(values, axis=0)
    ordered, summed = np.take_along_axis(values, order, 0), np.cumsum(np.take_along_axis(weight, order, 0), axis=0)
    places = (summed < 0.5 * summed[-1]).sum(axis=0).clip(0, len(values) - 1)
    return ordered[places, np.arange(values.shape[1])]


def _perpendicular(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two unit vectors (…, 3), perpendicular to unit vectors and to each other."""
    least = np.eye(3)[np.abs(vectors).argmin(axis=-1)]
    first = unit(np.cross(vectors, least))
    return first, np.cross(vectors, first)


def _covered(domain: Domain) -> Texels:
    rows, columns = np.nonzero(domain.bake.coverage)
    return rows, columns
