"""Oracle of the swarm passes: float64 numpy from Eq. 1–4 of the paper, independent of the shaders.

Arrays of particles are (m, H, W, D), of texels (H, W, …). D is 4 or 8: the dimensions past the n searched ones move
too, as on the GPU, and are never evaluated.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from irpso_addon.geometry.domain import Domain, GeometryBake
from irpso_addon.reflectance.model import Parameter, ReflectanceModel
from irpso_addon.solver.settings.groups import Fitness
from irpso_addon.solver.settings.resolve import ResolvedSwarm
from irpso_addon.solver.settings.schedule import Schedule
from tests.oracles.loss import loss
from tests.oracles.random_numbers import random_bits, random_uniform

UNFIT = 1e30
CHOICE, R1, R2, POSITION, VELOCITY = 0, 1, 3, 5, 7  # streams of random numbers
HORIZON = 1e-7


# ---- materials ---------------------------------------------------------------------------------------------------


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the scalar product over the last axis, as (…, 1)."""
    return (a * b).sum(axis=-1, keepdims=True)


def lambert(s: dict[str, np.ndarray], light: np.ndarray, view: np.ndarray) -> np.ndarray:
    """Return albedo times the cosine where light and view are above the horizon, else 0."""
    cosine = dot(s["normal"], light)
    return s["base_color"] * np.where((cosine > HORIZON) & (dot(s["normal"], view) > HORIZON), cosine, 0)


def cook_torrance_two_lobe(s: dict[str, np.ndarray], light: np.ndarray, view: np.ndarray) -> np.ndarray:
    """Return Lambert plus π D F G / (4 n·v), D a mixture of two Beckmann lobes, G of V-shaped cavities."""
    n, h = s["normal"], (light + view) / np.linalg.norm(light + view, axis=-1, keepdims=True)
    nl, nv, nh, vh = dot(n, light), dot(n, view), dot(n, h), dot(view, h)
    with np.errstate(all="ignore"):
        tangent = (1 - nh**2) / nh**2
        lobes = [np.exp(-tangent / s[r] ** 2) / (np.pi * s[r] ** 2 * nh**4) for r in ("r1", "r2")]
        d = s["w"] * lobes[0] + (1 - s["w"]) * lobes[1]
        f = 0.028 + 0.972 * (1 - vh) ** 5
        g = np.minimum(1, np.minimum(2 * nh * nv / vh, 2 * nh * nl / vh))
        specular = np.pi * d * f * g / (4 * nv)
    return np.where((nl > HORIZON) & (nv > HORIZON), s["base_color"] * nl + specular, 0)


MODELS = {"lambert": lambert, "cook_torrance_two_lobe": cook_torrance_two_lobe}


# ---- positions in [0, 1]ⁿ ----------------------------------------------------------------------------------------


def hemisphere_to_normal(x: np.ndarray) -> np.ndarray:
    """Return unit normals of (…, 2) positions: square to disc by ellipses (Fong 2015), disc to hemisphere by area."""
    q = 2 * x - 1
    d = np.stack([q[..., 0] * np.sqrt(1 - q[..., 1] ** 2 / 2), q[..., 1] * np.sqrt(1 - q[..., 0] ** 2 / 2)], axis=-1)
    r2 = np.minimum(dot(d, d), 1)
    return np.concatenate([d * np.sqrt(2 - r2), 1 - r2], axis=-1)


def normal_to_hemisphere(n: np.ndarray) -> np.ndarray:
    """Return (…, 2) positions of unit normals; those below the horizon move onto it."""
    xy, z = n[..., :2], n[..., 2:]
    below = xy / np.sqrt(np.maximum(dot(xy, xy), 1e-20))
    u, v = np.moveaxis(np.where(z <= 0, below, xy / np.sqrt(np.maximum(1 + z, 1e-20))), -1, 0)
    # Fong 2015, Eq. for the inverse of the elliptical grid mapping.
    a, b = 2 + u**2 - v**2, 2 - u**2 + v**2
    root = [np.sqrt(np.maximum(c, 0)) for c in (a + 8**0.5 * u, a - 8**0.5 * u, b + 8**0.5 * v, b - 8**0.5 * v)]
    return np.clip(0.5 + 0.25 * np.stack([root[0] - root[1], root[2] - root[3]], axis=-1), 0, 1)


def cartesian_to_normal(x: np.ndarray) -> np.ndarray:
    """Return unit normals of (…, 3) positions, with |z|."""
    n = 2 * x - 1
    length = np.linalg.norm(n, axis=-1, keepdims=True)
    n = np.concatenate([n[..., :2], np.abs(n[..., 2:])], axis=-1)
    return np.where(length > 1e-6, n / np.maximum(length, 1e-6), (0.0, 0.0, 1.0))


@dataclass(frozen=True)
class Problem:
    """The input of one phase. estimates: name → (H, W, c)."""

    domain: Domain
    model: ReflectanceModel
    stage: ResolvedSwarm
    schedule: Schedule
    estimates: dict[str, np.ndarray]
    scale: np.ndarray
    particles: int
    seed: int = 0

    @property
    def places(self) -> list[tuple[str, int, int]]:
        """(name, first dimension, count) of every searched parameter."""
        result, at = [], 0
        for p in self.stage.parameters:
            size = (2 if self.schedule.swarm.normal == "hemisphere" else 3) if p.is_normal else p.components
            result.append((p.name, at, size))
            at += size
        return result

    @property
    def dimensions(self) -> int:
        """n, the number of searched dimensions."""
        return sum(size for _, _, size in self.places)

    @property
    def columns(self) -> int:
        """D, n rounded up to whole RGBA texels."""
        return 4 if self.dimensions <= 4 else 8

    def width_of(self, p: Parameter) -> np.ndarray | float:
        """Return the searched part of a parameter's range: for a linear colour up to its brightness."""
        low, high = p.range
        factor = self.schedule.swarm.linear_limit
        if p.kind == "linear" and p.components == 3 and factor:
            return np.minimum(high, factor * self.scale[..., None]) - low
        return high - low

    @property
    def level(self) -> np.ndarray:
        """(H, W): the texel's scale as radiance."""
        return self.domain.intensities.astype(np.float64).mean() * self.scale

    @property
    def delta(self) -> np.ndarray:
        """(K, H, W, 1): δ of every sample."""
        return delta_of(self.domain.stack.values, self.level, self.schedule.fitness, self.domain.noise)

    def decode(self, x: np.ndarray) -> dict[str, np.ndarray]:
        """Return the material of positions (H, W, D): the estimates with the searched parameters replaced."""
        s = {name: np.asarray(value, np.float64) for name, value in self.estimates.items()}
        for name, at, size in self.places:
            part = x[..., at : at + size]
            p = self.model.parameter(name)
            if p.is_normal:
                s[name] = hemisphere_to_normal(part) if size == 2 else cartesian_to_normal(part)
            else:
                s[name] = p.range[0] + self.width_of(p) * part
        return s

    def encode(self, s: dict[str, np.ndarray]) -> np.ndarray:
        """Return the positions (H, W, D) of a material."""
        x = np.zeros((*self.domain.shape, self.columns))
        for name, at, size in self.places:
            p, value = self.model.parameter(name), np.asarray(s[name], np.float64)
            if p.is_normal:
                x[..., at : at + size] = normal_to_hemisphere(value) if size == 2 else 0.5 * value + 0.5
            else:
                x[..., at : at + size] = np.clip((value - p.range[0]) / self.width_of(p), 0, 1)
        return x


# ---- Eq. 1: the fitness ------------------------------------------------------------------------------------------


def frames(bake: GeometryBake) -> np.ndarray:
    """Return (H, W, 3, 3) float64, rows tangent, bitangent and normal."""
    n, t = bake.normal.astype(np.float64), bake.tangent.astype(np.float64)
    return np.stack([t[..., :3], t[..., 3:] * np.cross(n, t[..., :3]), n], axis=-2)


def turned(frame: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Return a world vector (…, 3) in a frame's coordinates."""
    return np.einsum("...ij,...j->...i", frame, vector)


def direction_to(row: np.ndarray, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the unit direction to a light or view (xyz, 1 for a position), and (…, 1) its distance squared, or 1."""
    row = row.astype(np.float64)
    if row[3] == 0:
        return np.broadcast_to(row[:3], position.shape), np.ones((*position.shape[:-1], 1))
    toward = row[:3] - position
    squared = dot(toward, toward)
    return toward / np.sqrt(squared), squared


def delta_of(samples: np.ndarray, level: np.ndarray, settings: Fitness, noise: float = 0.0) -> np.ndarray:
    """Return (…, 1): δ of samples (…, 4), at texels of the scale ``level`` in radiance; noise: of sRGB codes."""
    brightest = np.where(samples[..., 3] > 0, samples[..., :3].max(axis=-1), 0).astype(np.float64)
    delta = settings.delta * level * np.maximum(brightest / level, 1) ** settings.highlight_power
    y = np.clip(brightest, 0, 1)
    code = np.where(y <= 0.0031308, 12.92 * y, 1.055 * np.maximum(y, 1e-9) ** (1 / 2.4) - 0.055)
    step = 1e-6  # of a code: the slope by differences of the curve itself
    ends = [np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4) for c in (code - step, code + step)]
    return np.hypot(delta, noise * (ends[1] - ends[0]) / (2 * step))[..., None]


def fitness(problem: Problem, x: np.ndarray) -> np.ndarray:
    """Return (H, W): the mean loss of the render of positions (H, W, D) over weighted samples and channels; Eq. 1."""
    domain, settings = problem.domain, problem.schedule.fitness
    frame, position = frames(domain.bake), domain.bake.position.astype(np.float64)
    s = problem.decode(x)
    total, weights = np.zeros(domain.shape), np.zeros(domain.shape)
    unit = problem.delta if settings.loss == "cauchy" else np.ones(domain.observations)
    for k in range(domain.observations):
        light, squared = direction_to(domain.lights[k], position)
        view, _ = direction_to(domain.views[k], position)
        render = MODELS[problem.model.name](s, turned(frame, light), turned(frame, view))
        render = render * domain.intensities[k].astype(np.float64) / squared
        weight = domain.stack.values[k, ..., 3].astype(np.float64)
        error = render - np.where(weight[..., None] > 0, domain.stack.values[k, ..., :3], 0)
        total += weight * loss(settings.loss, error / unit[k]).sum(axis=-1)
        weights += weight
    return np.where(weights > 0, total / np.maximum(3 * weights, 1e-300), UNFIT)


# ---- Eq. 2–4: the swarm ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class State:
    """x, v, p: (m, H, W, D). p_fitness: (m, H, W). g: (H, W, D). g_fitness: (H, W)."""

    x: np.ndarray
    v: np.ndarray
    p: np.ndarray
    p_fitness: np.ndarray
    g: np.ndarray
    g_fitness: np.ndarray


@dataclass(frozen=True)
class Step:
    """The next state. particle: (H, W) index of the moved particle, −1 for none. fitness: (H, W).

    margin: (H, W) difference of its fitness from the compared one: where it is tiny, float32 may decide otherwise.
    """

    state: State
    particle: np.ndarray
    fitness: np.ndarray
    margin: np.ndarray = field(repr=False)


def solved_and_covered(domain: Domain) -> tuple[np.ndarray, np.ndarray]:
    """Return (H, W) bool: the solved texels, and those that count as neighbours (with the halo)."""
    covered = domain.bake.coverage & (domain.stack.values[..., 3] > 0).any(axis=0)
    left, right, bottom, top = domain.halo
    rows, columns = domain.shape
    y, x = np.mgrid[:rows, :columns]
    inside = (x >= left) & (x < columns - right) & (y >= bottom) & (y < rows - top)
    return covered & inside, covered


def neighbourhood_mean(problem: Problem, g: np.ndarray) -> np.ndarray:
    """Return (H, W, D): the mean of the covered global bests in the H×H window; on a mesh in the texel's own frame."""
    _, covered = solved_and_covered(problem.domain)
    frame = frames(problem.domain.bake)
    radius = problem.schedule.swarm.neighbourhood // 2
    rows, columns = problem.domain.shape
    result = np.zeros_like(g)
    for y, x in np.argwhere(covered):
        window = []
        for j in range(max(0, y - radius), min(rows, y + radius + 1)):
            for i in range(max(0, x - radius), min(columns, x + radius + 1)):
                if covered[j, i]:
                    own = (j, i) == (y, x) or problem.domain.card
                    window.append(g[j, i] if own else _in_frame(problem, g[j, i], frame[j, i], frame[y, x]))
        result[y, x, : problem.dimensions] = np.mean(window, axis=0)[: problem.dimensions]
    return result


def _in_frame(problem: Problem, g: np.ndarray, source: np.ndarray, target: np.ndarray) -> np.ndarray:
    g = g.copy()
    for name, at, size in problem.places:
        if problem.model.parameter(name).is_normal:
            part = g[at : at + size]
            if size == 2:
                n = target @ (source.T @ hemisphere_to_normal(part))
                g[at : at + size] = normal_to_hemisphere(n)
            else:
                n = 2 * part - 1
                n[2] = abs(n[2])
                g[at : at + size] = 0.5 * (target @ (source.T @ n)) + 0.5
    return g


def c3_at(schedule: Schedule, iteration: int, iterations: int) -> float:
    """Return the neighbour constant: constant, or falling linearly to 0 over the fraction c3_fade."""
    until = schedule.swarm.c3_fade
    return schedule.swarm.c3 * (max(0.0, 1 - max(iteration, 0) / (until * iterations)) if until else 1.0)


def choice(problem: Problem, iteration: int) -> np.ndarray:
    """Return (H, W): the index of the particle that moves."""
    x, y = global_texels(problem.domain)
    return ((random_bits(problem.seed, iteration, x, y, 0, CHOICE)[..., 0] >> 8) % problem.particles).astype(int)


def global_texels(domain: Domain) -> tuple[np.ndarray, np.ndarray]:
    """Return the global (x, y) of every texel."""
    y, x = np.mgrid[: domain.shape[0], : domain.shape[1]]
    return x + domain.origin[0], y + domain.origin[1]


def uniforms(problem: Problem, iteration: int, particle, purpose: int) -> np.ndarray:
    x, y = global_texels(problem.domain)
    blocks = [random_uniform(problem.seed, iteration, x, y, particle, purpose + b) for b in range(problem.columns // 4)]
    return np.concatenate(blocks, axis=-1)


def place(problem: Problem, state: State, index: int) -> Step:
    """Return the state after particle ``index`` of every swarm gets its first position."""
    swarm, iteration = problem.schedule.swarm, index - problem.particles
    starting = int(np.ceil(swarm.start_fraction * problem.particles)) if swarm.start != "random" else 0
    starting = max(1, starting) if problem.stage.cycle else starting
    x = uniforms(problem, iteration, index, POSITION)
    if index < starting:
        spread = swarm.start_spread if index else 0.0
        x = np.clip(problem.encode(problem.estimates) + spread * (2 * x - 1), 0, 1)
    v = swarm.start_speed * (2 * uniforms(problem, iteration, index, VELOCITY) - 1)
    which = np.full(problem.domain.shape, index)
    return _committed(problem, state, which, x, v, iteration)


def stepped(
    problem: Problem, state: State, which: np.ndarray, mean: np.ndarray | None, iteration: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return positions, velocities (H, W, D) of particle ``which`` (H, W) after Eq. 2, 3. mean: A of Eq. 4, or None."""
    swarm = problem.schedule.swarm
    x, v, p = (np.take_along_axis(a, which[None, ..., None], axis=0)[0] for a in (state.x, state.v, state.p))
    c3 = c3_at(problem.schedule, iteration, problem.stage.iterations)
    mean = x if mean is None else mean
    r1, r2 = (uniforms(problem, iteration, which, purpose) for purpose in (R1, R2))
    v = swarm.inertia * v + swarm.c1 * r1 * (p - x) + swarm.c2 * r2 * (state.g - x) + c3 * (mean - x)
    v = np.clip(swarm.constriction * v, -swarm.v_max, swarm.v_max)
    target = x + v
    x = np.clip(target, 0, 1)
    if swarm.walls != "clamp":
        v = np.where(x == target, v, 0 if swarm.walls == "stop" else -v)
    return x, v


def mean_at(problem: Problem, state: State, iteration: int) -> np.ndarray | None:
    """Return the neighbourhood mean where Eq. 2 uses it, else None."""
    c3 = c3_at(problem.schedule, iteration, problem.stage.iterations)
    return neighbourhood_mean(problem, state.g) if c3 else None


def move(problem: Problem, state: State, iteration: int) -> Step:
    """Return the state after one iteration: Eq. 2 and 3 for a random particle of every swarm, then the bests."""
    swarm = problem.schedule.swarm
    which = choice(problem, iteration)
    x, v = stepped(problem, state, which, mean_at(problem, state, iteration), iteration)
    if swarm.neighbour_interval and (iteration + 1) % swarm.neighbour_interval == 0:
        x = neighbours_best(problem, state.g, x, chance_direction(problem, iteration))
    return _committed(problem, state, which, x, v, iteration)


def neighbours_best(problem: Problem, g: np.ndarray, x: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Return (H, W, D) bests of the neighbour in ``direction`` (H, W); ``x`` where that texel is not solved.

    direction: 0 … 7, row by row from the lower left.
    """
    around = [(dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if (dy, dx) != (0, 0)]
    _, covered = solved_and_covered(problem.domain)
    frame = frames(problem.domain.bake)
    result = x.copy()
    for y, x_ in np.argwhere(covered):
        dy, dx = around[direction[y, x_]]
        j, i = y + dy, x_ + dx
        if 0 <= j < covered.shape[0] and 0 <= i < covered.shape[1] and covered[j, i]:
            own = problem.domain.card
            result[y, x_] = g[j, i] if own else _in_frame(problem, g[j, i], frame[j, i], frame[y, x_])
    return result


def chance_direction(problem: Problem, iteration: int) -> np.ndarray:
    """Return (H, W): the random direction, 0 … 7, of the neighbour whose best a texel reads."""
    columns, rows = global_texels(problem.domain)
    return ((random_bits(problem.seed, iteration, columns, rows, 0, CHOICE)[..., 1] >> 8) % 8).astype(int)


def ordered_lobes(problem: Problem, x: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and velocities with interchangeable lobes in ascending order."""
    at = {name: first for name, first, _ in problem.places}
    estimated = {*at, *(p.name for p in problem.stage.solved)}
    lobes, weights = problem.model.ordered, problem.model.complement
    if not lobes or any(name not in at for name in lobes) or any(name not in estimated for name in weights):
        return x, v
    first, second = (at[name] for name in problem.model.ordered)
    swap = (x[..., first] > x[..., second])[..., None]
    order = np.arange(x.shape[-1])
    order[[first, second]] = second, first
    other_x, other_v = x[..., order].copy(), v[..., order].copy()
    for name in set(weights) & set(at):
        other_x[..., at[name]] = 1 - other_x[..., at[name]]
        other_v[..., at[name]] = -other_v[..., at[name]]
    return np.where(swap, other_x, x), np.where(swap, other_v, v)


def _committed(problem: Problem, state: State, which: np.ndarray, x: np.ndarray, v: np.ndarray, iteration: int) -> Step:
    solved, _ = solved_and_covered(problem.domain)
    moved = solved & (state.g_fitness > problem.schedule.threshold)
    x, v = ordered_lobes(problem, x, v)
    fit = fitness(problem, x)
    own = np.take_along_axis(state.p_fitness, which[None], axis=0)[0]
    improved = np.ones_like(moved) if iteration < 0 else fit < own
    leads = (fit < state.g_fitness) | ((iteration < 0) & (which == 0))
    chosen = (np.arange(problem.particles)[:, None, None] == which) & moved
    better = chosen & improved
    best = moved & leads
    after = State(
        np.where(chosen[..., None], x, state.x),
        np.where(chosen[..., None], v, state.v),
        np.where(better[..., None], x, state.p),
        np.where(better, fit, state.p_fitness),
        np.where(best[..., None], x, state.g),
        np.where(best, fit, state.g_fitness),
    )
    margin = np.abs(fit - state.g_fitness)
    margin = margin if iteration < 0 else np.minimum(margin, np.abs(fit - own))
    return Step(after, np.where(moved, which, -1), fit, np.where(moved, margin, np.inf))
