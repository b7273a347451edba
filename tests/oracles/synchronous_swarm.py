"""Oracle of the synchronous swarm: one iteration in float64, with linear weights in closed form. Extends ``swarm``.

Arrays of particles are (m, H, W, …), of texels (H, W, …). Linear weights are (…, L), in the order of the model's table
with colours first.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import product

import numpy as np

from tests.oracles import confidence as confidence_oracle
from tests.oracles import swarm
from tests.oracles.loss import loss, loss_weight

EDGE = 3e-6  # of a cosine: in float32 normals at the walls of their square reach the horizon within this


@dataclass(frozen=True)
class SynchronousSwarm(swarm.Problem):
    """A problem whose phase may have ``solved`` parameters and no searched ones."""

    @property
    def weights(self) -> list[tuple[str, int, float, float]]:
        """(name, component, lowest, highest) of every linear weight."""
        solved = sorted(self.stage.solved, key=lambda p: -p.components)
        return [(p.name, i, *p.range) for p in solved for i in range(p.components)]

    def with_weights(self, s: dict[str, np.ndarray], w: np.ndarray) -> dict[str, np.ndarray]:
        """Return a material with its linear weights replaced by ``w``, (…, L)."""
        s, at = dict(s), 0
        for p in sorted(self.stage.solved, key=lambda p: -p.components):
            s[p.name] = w[..., at : at + p.components]
            at += p.components
        return s

    def material(self, x: np.ndarray, w: np.ndarray) -> dict[str, np.ndarray]:
        """Return the material of positions (…, H, W, D) and linear weights (…, H, W, L)."""
        return self.with_weights(self.decode(x), w)


def radiance(problem: SynchronousSwarm, s: dict[str, np.ndarray]) -> np.ndarray:
    """Return (K, …, H, W, 3), the render of a material; 0 where light or view are at or below the horizon."""
    domain = problem.domain
    above = [(light > swarm.HORIZON) & (view > swarm.HORIZON) for light, view in cosines(problem, s["normal"])]
    return np.where(above, confidence_oracle.radiance(domain, problem.model.name, s), 0)


def cosines(problem: SynchronousSwarm, n: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield n·l and n·v (…, H, W, 1) of every observation."""
    domain = problem.domain
    frame, position = swarm.frames(domain.bake), domain.bake.position.astype(np.float64)
    for light, view in zip(domain.lights, domain.views, strict=True):
        yield tuple(swarm.dot(n, swarm.turned(frame, swarm.direction_to(row, position)[0])) for row in (light, view))


def on_edge(problem: SynchronousSwarm, n: np.ndarray) -> np.ndarray:
    """Return (…, H, W): whether rounding decides if a light or view is above the horizon of a normal."""
    edge = False
    for weight, pair in zip(problem.domain.stack.values[..., 3], cosines(problem, n), strict=True):
        edge = edge | ((weight > 0) & np.any([np.abs(c[..., 0]) < EDGE for c in pair], axis=0))
    return edge


def error(problem: SynchronousSwarm, s: dict[str, np.ndarray]) -> np.ndarray:
    """Return (K, …, H, W, 3): render of a material minus samples, in units of the loss."""
    domain = problem.domain
    seen = _expanded(domain.stack.values[..., 3:] > 0, s["normal"])
    reference = _expanded(
        np.where(domain.stack.values[..., 3:] > 0, domain.stack.values[..., :3], 0).astype(np.float64), s["normal"]
    )
    result = np.where(seen, radiance(problem, s) - reference, 0)
    if problem.schedule.fitness.loss == "cauchy":
        result = result / _expanded(problem.delta, s["normal"])
    return result


def _expanded(samples: np.ndarray, normal: np.ndarray) -> np.ndarray:
    return samples[:, None] if normal.ndim == 4 else samples


def fitness(problem: SynchronousSwarm, s: dict[str, np.ndarray]) -> np.ndarray:
    """Return (…, H, W): the mean loss over weighted samples and channels; Eq. 1."""
    e = error(problem, s)
    each = loss(problem.schedule.fitness.loss, e)
    weight = _expanded(problem.domain.stack.values[..., 3].astype(np.float64), s["normal"])
    total, weights = (weight * each.sum(axis=-1)).sum(axis=0), weight.sum(axis=0)
    return np.where(weights > 0, total / np.maximum(3 * weights, 1e-300), swarm.UNFIT)


def sample_weights(problem: SynchronousSwarm, incumbent: dict[str, np.ndarray]) -> np.ndarray:
    """Return (K, H, W, 3): weight of each sample in the least squares, from the incumbent's error."""
    e = error(problem, incumbent)
    weight = problem.domain.stack.values[..., 3:].astype(np.float64)
    if problem.schedule.fitness.loss == "cauchy":  # from units of the sample's δ² to those of the texel's
        weight = weight * (problem.schedule.fitness.delta * problem.level[..., None] / problem.delta) ** 2
    white = problem.domain.intensities.astype(np.float64).mean()
    return weight * loss_weight(problem.schedule.fitness.loss, e, white)


def system(problem: SynchronousSwarm, s: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return (K, …, H, W, 3, L), the radiance of each weight at 1, and (K, …, H, W, 3), the one left to the weights.

    The bases are differences of renders, independent of the shaders' split into bases.
    """
    shape = s["normal"].shape[:-1]
    none = np.zeros((*shape, len(problem.weights)))
    rest = radiance(problem, problem.with_weights(s, none))
    columns = []
    for i in range(len(problem.weights)):
        one = none.copy()
        one[..., i] = 1
        render = radiance(problem, problem.with_weights(s, one))
        columns.append(render - rest)
    seen = problem.domain.stack.values[..., 3:] > 0
    left = _expanded(np.where(seen, problem.domain.stack.values[..., :3], 0).astype(np.float64), s["normal"])
    return np.stack(columns, axis=-1), left - rest


def solve(problem: SynchronousSwarm, s: dict[str, np.ndarray], counted: np.ndarray) -> np.ndarray:
    """Return (…, H, W, L), the least-squares weights inside their ranges. counted: (K, H, W, 3) weights of the samples.

    Tries every combination of weights at either end of their range and returns the best feasible one.
    """
    ranges = np.array([row[2:] for row in problem.weights])
    a, right = system(problem, s)
    counted = _expanded(counted, s["normal"])
    gram = np.einsum("k...ci,k...c,k...cj->...ij", a, np.broadcast_to(counted, right.shape), a, optimize=True)
    side = np.einsum("k...ci,k...c,k...c->...i", a, np.broadcast_to(counted, right.shape), right, optimize=True)
    dark = np.einsum("...ii->...i", gram) == 0  # a weight that no observation shows stays at its lower limit
    gram = gram + np.where(dark, 1.0, 0.0)[..., None] * np.eye(len(ranges))
    side = np.where(dark, ranges[:, 0], side)
    best, lowest = np.full(side.shape, np.nan), np.full(side.shape[:-1], np.inf)
    for ends in product((None, 0, 1), repeat=len(ranges)):
        w = np.zeros(side.shape)
        free = np.array([end is None for end in ends])
        for i, end in enumerate(ends):
            if end is not None:
                w[..., i] = ranges[i, end]
        if free.any():
            fixed = side - np.einsum("...ij,...j->...i", gram, w)
            part = gram[..., free, :][..., free]
            regular = part + 1e-14 * np.einsum("...ii->...", part)[..., None, None] * np.eye(free.sum())
            w[..., free] = np.linalg.solve(regular, fixed[..., free][..., None])[..., 0]
        cost = 0.5 * np.einsum("...i,...ij,...j->...", w, gram, w) - (w * side).sum(axis=-1)
        inside = ((w >= ranges[:, 0] - 1e-12) & (w <= ranges[:, 1] + 1e-12)).all(axis=-1)
        better = inside & (cost < lowest)
        lowest = np.where(better, cost, lowest)
        best = np.where(better[..., None], w, best)
    return best


@dataclass(frozen=True)
class State(swarm.State):
    """A swarm's state with the linear weights (H, W, L) of its global best."""

    w: np.ndarray


@dataclass(frozen=True)
class Generation:
    """The next state. fitness: (m, H, W) and weights: (m, H, W, L) of the particles.

    edge: (m, H, W) whether rounding decides if a light is above the horizon of a particle or of the incumbent.
    margin: (m, H, W) difference from the personal best, lead: (H, W) lead of the best particle: where they are tiny,
    float32 may decide otherwise.
    """

    state: State
    fitness: np.ndarray
    weights: np.ndarray
    moved: np.ndarray
    edge: np.ndarray
    margin: np.ndarray = field(repr=False)
    lead: np.ndarray = field(repr=False)


def placed(problem: SynchronousSwarm, state: State) -> Generation:
    """Return the state after iteration −1, which gives all particles their first positions."""
    constants = problem.schedule.swarm
    starting = int(np.ceil(constants.start_fraction * problem.particles)) if constants.start != "random" else 0
    guess = problem.encode(problem.estimates)
    # A Lambertian fit gives the normal and the colour only: other numbers are random, except in particle 0.
    guessed = np.zeros(problem.columns, bool)
    for name, at, size in problem.places:
        p = problem.model.parameter(name)
        guessed[at : at + size] = p.is_normal or (p.kind == "linear" and p.components == 3)
    xs, vs = [], []
    for k in range(problem.particles):
        chance = swarm.uniforms(problem, -1, k, swarm.POSITION)
        spread = constants.start_spread if k else 0.0
        near = np.clip(guess + spread * (2 * chance - 1), 0, 1)
        xs.append(np.where((k < starting) & (guessed | (k == 0)), near, chance))
        vs.append(constants.start_speed * (2 * swarm.uniforms(problem, -1, k, swarm.VELOCITY) - 1))
    return _committed(problem, state, np.stack(xs), np.stack(vs), problem.estimates, start=True)


def generation(problem: SynchronousSwarm, state: State, iteration: int) -> Generation:
    """Return the state after one iteration: Eq. 2 and 3 for every particle, then the bests."""
    every = problem.schedule.swarm.neighbour_interval
    mean = swarm.mean_at(problem, state, iteration)
    xs, vs = [], []
    for k in range(problem.particles):
        which = np.full(problem.domain.shape, k)
        x, v = swarm.stepped(problem, state, which, mean, iteration)
        last = problem.particles - 1 - k
        if every and (iteration + 1) % every == 0 and last < 4:
            beside = np.full(problem.domain.shape, (1, 3, 4, 6)[last])
            x = swarm.neighbours_best(problem, state.g, x, beside)
        xs.append(x)
        vs.append(v)
    incumbent = problem.material(state.g, state.w)
    return _committed(problem, state, np.stack(xs), np.stack(vs), incumbent, start=False)


def _committed(
    problem: SynchronousSwarm, state: State, x: np.ndarray, v: np.ndarray, incumbent: dict[str, np.ndarray], start: bool
) -> Generation:
    solved, _ = swarm.solved_and_covered(problem.domain)
    moved = solved & (state.g_fitness > problem.schedule.threshold)
    x, v = swarm.ordered_lobes(problem, x, v)
    s = problem.decode(x)
    w = np.zeros((*x.shape[:-1], 0))
    if problem.weights:
        s["normal"] = np.broadcast_to(s["normal"], (*x.shape[:-1], 3))
        w = solve(problem, s, sample_weights(problem, {n: np.asarray(a, np.float64) for n, a in incumbent.items()}))
        s = problem.with_weights(s, w)
    fit = np.broadcast_to(fitness(problem, s), x.shape[:-1])
    improved = moved & (start | (fit < state.p_fitness))
    leader = np.argmin(fit, axis=0)
    lowest = np.min(fit, axis=0)
    leads = moved & (start | (lowest < state.g_fitness))

    def of_leader(a: np.ndarray) -> np.ndarray:
        return np.take_along_axis(a, leader[None, ..., None], axis=0)[0]

    after = State(
        np.where(moved[..., None], x, state.x),
        np.where(moved[..., None], v, state.v),
        np.where(improved[..., None], x, state.p),
        np.where(improved, fit, state.p_fitness),
        np.where(leads[..., None], of_leader(x), state.g),
        np.where(leads, lowest, state.g_fitness),
        np.where(leads[..., None], of_leader(w), state.w),
    )
    second = np.sort(fit, axis=0)[1] if len(fit) > 1 else np.full(fit.shape[1:], np.inf)
    lead = second - lowest if start else np.minimum(second - lowest, np.abs(lowest - state.g_fitness))
    margin = np.full(fit.shape, np.inf) if start else np.abs(fit - state.p_fitness)
    edge = np.broadcast_to(on_edge(problem, s["normal"]), fit.shape)
    edge = edge | (on_edge(problem, incumbent["normal"]) if problem.weights else False)
    margin, lead = np.where(edge, 0, margin), np.where(edge.any(axis=0), 0, lead)
    return Generation(
        after, fit, w, moved, edge & moved, np.where(moved, margin, np.inf), np.where(moved, lead, np.inf)
    )
