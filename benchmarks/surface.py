"""What the phase Surface does to normals: cards of waves, fine waves, tilted tiles and pyramids, with and without it.

Usage: python -m benchmarks.surface [--size 48] [--rounds 2] [--weight 1] [--smoothness 1]

A card's slopes are those of its relief at the texels' centres; tiles tilt and end independently of each other, so that
their borders are steps of the surface. Materials differ from patch to patch. The program renders the true maps under
even lights down to 63° from the axis, and Gaussian noise is added, a fraction of the samples' mean. The second card
showed that what is searched has to be held (solver/kernels/surface.py); the weight was chosen by others. Progress goes
to stderr, the table to stdout.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

from benchmarks.peers.problem import angles
from benchmarks.subjects import spiral_lights
from irpso_addon.geometry.domain import Domain, domain_of, flat_bake, with_samples
from irpso_addon.gpu import context
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.engine.recovery import Recovery
from irpso_addon.solver.settings.schedule import Schedule, load_schedule
from irpso_addon.solver.views.forward import rendered

MODEL = "metallic_roughness"
CARDS = [  # relief, material, lights, noise
    ("waves", "glossy", 4, 0.02), ("tiles", "matt", 4, 0.03), ("waves", "matt", 6, 0.02), ("tiles", "glossy", 8, 0.03),
    ("fine", "glossy", 16, 0.02), ("pyramids", "matt", 16, 0.01), ("tiles", "metal", 96, 0.02),
    ("fine", "matt", 96, 0.01),
]  # fmt: skip
_MATERIALS = {  # base colours, roughness and metallic of three materials
    "matt": (((0.5, 0.3, 0.2), (0.3, 0.5, 0.6), (0.7, 0.65, 0.5)), (0.6, 0.8, 0.7), (0, 0, 0)),
    "glossy": (((0.5, 0.15, 0.1), (0.1, 0.2, 0.4), (0.25, 0.25, 0.25)), (0.15, 0.25, 0.35), (0, 0, 0)),
    "metal": (((0.9, 0.7, 0.3), (0.5, 0.3, 0.2), (0.6, 0.6, 0.6)), (0.3, 0.5, 0.35), (1, 0, 1)),
}


def slopes_of(relief: str, size: int, rng: np.random.Generator) -> np.ndarray:
    """Return (size, size, 2) slopes of a relief."""
    y, x = np.mgrid[:size, :size]
    if relief == "pyramids":
        u, v = (x % 16 - 7.5) / 8, (y % 16 - 7.5) / 8
        across = (np.abs(u) > np.abs(v))[..., None]
        return -0.5 * np.where(across, np.stack([np.sign(u), 0 * u], -1), np.stack([0 * v, np.sign(v)], -1))
    shortest, longest = (5, 20) if relief == "fine" else (12, 50)  # texels
    slopes = np.zeros((size, size, 2))
    for _ in range(8):
        length, turn, phase = np.exp(rng.uniform(np.log(shortest), np.log(longest))), *rng.uniform(0, 2 * np.pi, 2)
        along = np.array([np.cos(turn), np.sin(turn)])
        slopes += np.cos(2 * np.pi / length * (along[0] * x + along[1] * y) + phase)[..., None] * along
    slopes *= (0.15 if relief == "tiles" else 0.35) / np.sqrt((slopes**2).mean())
    return slopes + (0.35 * rng.normal(size=(20, 2))[_patches(size, 20, rng)] if relief == "tiles" else 0)


def make_card(relief: str, material: str, lights: int, noise: float, size: int, seed: int) -> tuple[Domain, np.ndarray]:
    """Return the observed domain and the true normals (size, size, 3)."""
    rng, shape = np.random.default_rng(seed), (size, size)
    normal = np.concatenate([-slopes_of(relief, size, rng), np.ones((*shape, 1))], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    patch = rng.integers(0, 3, 12)[_patches(size, 12, rng)]
    colour, roughness, metallic = (np.array(values, np.float32)[patch] for values in _MATERIALS[material])
    truth = {
        "base_color": colour, "normal": normal.astype(np.float32), "roughness": roughness[..., None],
        "metallic": metallic[..., None], "specular": np.full((*shape, 1), 0.5, np.float32),
    }  # fmt: skip
    y, x = np.mgrid[:size, :size].astype(np.float32)
    place = np.stack([x, y, 0 * x], axis=-1)
    bake = flat_bake(place, np.ones(shape, bool), place[..., :2] / size)
    towards = np.pad(spiral_lights(lights, 0.45), ((0, 0), (0, 1))).astype(np.float32)
    views = np.broadcast_to(np.float32([0, 0, 1, 0]), (lights, 4))
    stack = np.ones((lights, *shape, 4), np.float32)
    domain = domain_of(bake, stack, towards, np.ones((lights, 3), np.float32), views)
    clean = np.stack([picture[..., :3] for picture in rendered(domain, load_model(MODEL), truth, range(lights))])
    stack[..., :3] = np.maximum(clean + noise * clean.mean() * rng.normal(size=clean.shape), 0)
    return with_samples(domain, stack), normal


def errors(domain: Domain, normal: np.ndarray, schedule: Schedule) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors, in degrees, of every texel's normal before the phase and after it."""
    errors_by_state = []
    with Recovery(domain, load_model(MODEL), schedule, 1) as recovery:
        while recovery.progress.title != "surface":
            recovery.step(iterations=1)
        for _ in range(2):
            values = recovery.maps(confidence=False).values["normal"].astype(np.float64)
            errors_by_state.append(angles(values.reshape(-1, 3), normal.reshape(-1, 3)))
            recovery.step()
    return errors_by_state[0], errors_by_state[1]


def _patches(size: int, count: int, rng: np.random.Generator) -> np.ndarray:
    """Return (size, size) int, each texel's number of ``count`` Voronoi cells."""
    y, x = np.mgrid[:size, :size]
    centres = rng.uniform(0, size, (count, 2))
    return ((x[..., None] - centres[:, 0]) ** 2 + (y[..., None] - centres[:, 1]) ** 2).argmin(axis=-1)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=48, help="texels along a side")
    parser.add_argument("--rounds", type=int, default=2, help="of the phase")
    parser.add_argument("--weight", type=float, default=1.0, help="of the phase")
    parser.add_argument("--smoothness", type=float, default=1.0, help="of the phase")
    options = parser.parse_args()
    settings = {f"surface_{name}": getattr(options, name) for name in ("rounds", "weight", "smoothness")}
    schedule = load_schedule("standard").replaced(**settings)
    context.ensure()
    print("| relief | material | lights | noise | mean ° | change | median ° | change | 95 % ° | change |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for number, card in enumerate(CARDS):
        start = time.perf_counter()
        before, after = errors(*make_card(*card, options.size, 50 + number), schedule)
        cells = []
        for summary in (np.mean, np.median, lambda values: np.quantile(values, 0.95)):
            cells.append(f"{summary(before):.3f} | {100 * (summary(after) / summary(before) - 1):+.1f} %")
        relief, material, lights, noise = card
        print(f"| {relief} | {material} | {lights} | {noise:.0%} | {' | '.join(cells)} |", flush=True)
        print(f"{number + 1}/{len(CARDS)}, {time.perf_counter() - start:.0f} s", file=sys.stderr, flush=True)
    context.exit_process(0)


if __name__ == "__main__":
    main()
