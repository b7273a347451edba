"""Domains and subjects made in numpy for the tests of the solver, and recoveries of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from irpso_addon.geometry.domain import Domain, GeometryBake, domain_of, with_samples
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.settings.schedule import load_schedule
from irpso_addon.solver.state.packing import Packing
from tests.oracles.reflectance import unit
from tests.oracles.swarm import MODELS, direction_to, frames, turned

# Few iterations, and a neighbour term strong enough to show.
SHORT = load_schedule("swarm").replaced(iterations=12, start="random", c3=0.3, particles=6, particles_per_dimension=0.0)


def pack_layers(packing: Packing, layers: np.ndarray) -> np.ndarray:
    """Return (K, h, w, C) of (K, H, W, C)."""
    return np.stack([packing.pack(layer) for layer in layers])


def make_domain(
    height: int,
    width: int,
    observations: int = 8,
    card: bool = True,
    near: bool = False,
    perspective: bool = False,
    colored: bool = False,
    holes: bool = True,
    rng_seed: int = 1,
) -> Domain:
    """Return a domain of random geometry, lights and radiances in [0, 1]; with holes, samples of weight 0 are NaN."""
    rng = np.random.default_rng(rng_seed)
    grid = np.stack(np.meshgrid(np.linspace(-1, 1, width), np.linspace(-1, 1, height)), axis=-1)
    position = np.concatenate([grid, 0.2 * rng.normal(size=(height, width, 1))], axis=-1)
    normal = np.broadcast_to((0.0, 0.0, 1.0), (height, width, 3))
    tangent = np.broadcast_to((1.0, 0.0, 0.0), (height, width, 3))
    sign = np.ones((height, width, 1))
    if not card:
        normal = unit(np.array([0, 0, 1.0]) + 0.6 * rng.normal(size=(height, width, 3)))
        tangent = unit(np.cross(normal, rng.normal(size=(height, width, 3))))
        sign = rng.choice([-1.0, 1.0], size=(height, width, 1))
    lights = unit(rng.normal(size=(observations, 3)) * (1, 1, 0.5) + (0, 0, 1.5))
    if near:
        lights = lights * rng.uniform(1.5, 3, size=(observations, 1))
    views = np.broadcast_to((0.0, 0.0, 1.0, 0.0), (observations, 4))
    if perspective:
        views = np.concatenate(
            [rng.normal(size=(observations, 3)) * 0.5 + (0, 0, 4), np.ones((observations, 1))], axis=1
        )
    stack = rng.uniform(0, 1, size=(observations, height, width, 4))
    stack[..., 3] = rng.choice([0.5, 1.0], size=stack.shape[:3])
    coverage = np.ones((height, width), bool)
    if holes:
        stack[rng.random(stack.shape[:3]) < 0.15] = (np.nan, np.nan, np.nan, 0)
        coverage = rng.random((height, width)) > 0.15
        stack[:, rng.random((height, width)) < 0.05] = (np.nan, np.nan, np.nan, 0)
    intensities = rng.uniform(0.5, 2, size=(observations, 3)) if colored else np.ones((observations, 3))
    bake = GeometryBake(
        position.astype(np.float32), normal.astype(np.float32),
        np.concatenate([tangent, sign], axis=-1).astype(np.float32), coverage, np.zeros((height, width, 2), np.float32),
    )  # fmt: skip
    lights = np.concatenate([lights, np.full((observations, 1), float(near))], axis=1)
    arrays = (stack, lights, intensities, views)
    return domain_of(bake, *(np.ascontiguousarray(a, np.float32) for a in arrays), card=card)


def masked(domain: Domain, mask: np.ndarray) -> Domain:
    """Return the domain with only the covered texels of a mask (H, W)."""
    bake = replace(domain.bake, coverage=domain.bake.coverage & mask)
    return replace(domain, bake=bake, solvable=domain.solvable & mask)


def noisy(domain: Domain, sigma: float) -> Domain:
    """Return the domain with noise of a standard deviation on its samples."""
    stack = domain.stack.values.copy()
    stack[..., :3] += np.random.default_rng(5).normal(size=stack[..., :3].shape).astype(np.float32) * sigma
    return with_samples(domain, stack)


def with_radiance(domain: Domain, model: str, values: dict[str, np.ndarray]) -> Domain:
    """Return the domain with the radiance of a material; weights stay, samples of weight 0 are NaN."""
    frame, position = frames(domain.bake), domain.bake.position.astype(np.float64)
    stack = domain.stack.values.copy()
    for k in range(domain.observations):
        light, squared = direction_to(domain.lights[k], position)
        view, _ = direction_to(domain.views[k], position)
        render = MODELS[model](values, turned(frame, light), turned(frame, view)) * domain.intensities[k] / squared
        stack[k, ..., :3] = np.where(stack[k, ..., 3:] > 0, render, np.nan)
    return with_samples(domain, stack)


def random_truth(rng, shape):
    """Return random maps (H, W, C) float64 for all parameters of the models with lobes, normals near the surface's."""
    return {
        "base_color": rng.uniform(0.2, 0.9, (*shape, 3)),
        "normal": unit(rng.normal(size=(*shape, 3)) * 0.2 + (0, 0, 1)),
        "r1": rng.uniform(0.1, 0.2, (*shape, 1)),
        "r2": rng.uniform(0.4, 0.6, (*shape, 1)),
        "w": rng.uniform(0.3, 0.7, (*shape, 1)),
    }


def subject(height=13, width=17, model="lambert", rng_seed=3, **options):
    """Return (domain, truth) of a smooth subject with noise, rendered by the oracle's model."""
    rng = np.random.default_rng(rng_seed)
    shape = (height, width)
    truth = random_truth(rng, shape)
    truth = {p.name: truth[p.name].astype(np.float32) for p in load_model(model).parameters}
    return with_radiance(make_domain(height, width, **options), model, truth), truth


def bits_of(maps):
    """Return all values of maps as bytes, for bitwise comparison."""
    return {name: np.ascontiguousarray(v[maps.solved]).tobytes() for name, v in maps.values.items()}


def ended_prefit(recovery):
    """Step to the end of a recovery's first prefit; return the phase, its estimates resolved."""
    while recovery.progress.stage == 0 and recovery.progress.iteration < recovery.progress.iterations - 1:
        recovery.step(iterations=1)
    recovery.phase.write_estimates_at_once()
    return recovery.phase


def resumed(recover, domain, model, schedule, iterations):
    """Return the bits of two runs' maps; the second starts from the first one's checkpoint after some iterations."""
    both = first, second = [recover(domain, model, schedule) for _ in range(2)]
    first.step(iterations=iterations)
    second.restore(first.state())
    for recovery in both:
        recovery.step()
    return [bits_of(recovery.maps(confidence=False)) for recovery in both]


def sliced(recovery):
    """Return the bits of the maps of a recovery run in 2 ms slices, with its maps read after each."""
    while not recovery.step(time_budget_s=0.002).done:
        recovery.maps(confidence=False)
    return bits_of(recovery.maps(confidence=False))


def recoveries():
    """Yield a maker of recoveries and close them at the end, for a fixture."""
    from irpso_addon.solver.engine.recovery import Recovery  # needs Blender

    def recovery(domain, model=None, schedule=SHORT, seed=1, fixed=None, entry="fragment"):
        return Recovery(domain, model or load_model("lambert"), schedule, seed, fixed, entry)

    yield from makers(recovery)


def angles_of(recover, domain, model, schedules, normal):
    """Return the angles (H, W) between each schedule's normals and others (H, W, 3), and the last recovery."""
    errors = []
    for schedule in schedules:
        recovery = recover(domain, model, schedule)
        recovery.step()
        errors.append(degrees(recovery.maps(confidence=False), normal))
    return errors, recovery


def makers(kind):
    """Yield a maker of objects of a kind and close them at the end, for a fixture."""
    made = []

    def make(*arguments, **options):
        made.append(kind(*arguments, **options))
        return made[-1]

    yield make
    for one in made:
        one.close()


def run_tiled(domain, model, schedule, halo, entry="fragment"):
    """Recover a domain of 17×13 in tiles of uneven sizes; return the bits of its maps."""
    from irpso_addon.solver.engine.tiled import TiledRecovery  # needs Blender

    boxes = [(0, 0, 7, 5), (7, 0, 10, 5), (0, 5, 5, 8), (5, 5, 12, 3), (5, 8, 11, 5), (16, 8, 1, 5)]
    with TiledRecovery(domain, model, schedule, 1, entry=entry, boxes=boxes, halo=halo) as recovery:
        recovery.step()
        return bits_of(recovery.maps())


def degrees(maps, normal):
    """Return (H, W) angles between the normals of maps and others (H, W, 3)."""
    cosine = (maps.values["normal"].astype(np.float64) * normal).sum(axis=-1)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def around(values):
    """Return the sums of (H, W, n) over 5×5 texels and the rims of such squares with texels two and four apart."""
    near = [(x, y) for x in range(-2, 3) for y in range(-2, 3)]
    rim = [(x, y) for x, y in near if max(abs(x), abs(y)) == 2]
    height, width = values.shape[:2]
    padded = np.pad(values.astype(np.float64), ((8, 8), (8, 8), (0, 0)))
    taps = near + [(step * x, step * y) for step in (2, 4) for x, y in rim]
    return sum(padded[8 + y : 8 + y + height, 8 + x : 8 + x + width] for x, y in taps)
