"""What the neighbour term of Eq. 4 does to the error: a table over the window H and the constant c3.

Usage: python -m benchmarks.neighbour_term [--size 40] [--iterations 400] [--seeds 3] [--preset swarm]

A card is made in numpy: albedo and normals that are smooth in places and jump at the edges of tiles, photographed under
16 distant lights with a little noise. Every cell of the table is a joint recovery of albedo and normal (Lambert) from a
random start. "Edge" texels lie within two texels of a jump. Progress goes to stderr, the table to stdout.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass

import numpy as np

from benchmarks.subjects import spiral_lights
from irpso_addon.geometry.domain import Domain, domain_of, flat_bake
from irpso_addon.gpu import context
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.engine.recovery import Recovery
from irpso_addon.solver.settings.schedule import Schedule, load_schedule

LIGHTS = 16
NOISE = 0.003  # standard deviation of a sample, where white facing the light is 1
WINDOWS = (1, 3, 5, 9)
CONSTANTS = (0.02, 0.05, 0.1, 0.3)


@dataclass(frozen=True)
class Subject:
    """A card. domain: its observations. albedo, normal: (H, W, 3). edge: (H, W) bool, texels near a jump of either."""

    domain: Domain
    albedo: np.ndarray
    normal: np.ndarray
    edge: np.ndarray


def make_subject(size: int) -> Subject:
    """Return a card of ``size``² texels: waves, with tiles of another colour and tilt on them."""
    rng = np.random.default_rng(11)
    y, x = np.mgrid[:size, :size] / size
    tile = ((3 * x).astype(int) + (3 * y).astype(int)) % 2
    shade = 0.5 + 0.25 * np.sin(5 * x + 2 * y)[..., None] * (1.0, 0.6, -0.5)
    albedo = np.where(tile[..., None] == 1, shade, 0.35 + 0.3 * (x * (1 - y))[..., None] * (0.2, 1.0, 0.7))
    slope = np.stack([0.35 * np.cos(9 * x), 0.35 * np.sin(7 * y + 3 * x)], axis=-1)
    slope = slope + np.where(tile[..., None] == 1, (0.4, -0.3), (0.0, 0.0))
    normal = np.concatenate([slope, np.ones((size, size, 1))], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)

    lights = np.pad(spiral_lights(LIGHTS, 0.4), ((0, 0), (0, 1)))
    cosine = np.maximum(np.einsum("hwc,kc->khw", normal, lights[:, :3]), 0)
    radiance = albedo * cosine[..., None] + rng.normal(size=(LIGHTS, size, size, 3)) * NOISE
    stack = np.concatenate([radiance, np.ones((LIGHTS, size, size, 1))], axis=-1)

    plane = np.stack([x, y, np.zeros_like(x)], axis=-1)
    bake = flat_bake(plane, np.ones((size, size), bool), plane[..., :2])
    views = np.broadcast_to(np.float32([0, 0, 1, 0]), (LIGHTS, 4))
    domain = domain_of(
        bake, stack.astype(np.float32), lights.astype(np.float32), np.ones((LIGHTS, 3), np.float32), views
    )
    return Subject(domain, albedo, normal, _near_jump(tile, 2))


def _near_jump(tile: np.ndarray, reach: int) -> np.ndarray:
    padded = np.pad(tile, reach, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, (2 * reach + 1, 2 * reach + 1))
    return windows.min(axis=(2, 3)) != windows.max(axis=(2, 3))


def errors(subject: Subject, schedule: Schedule, seed: int) -> np.ndarray:
    """Return [early mean angle, mean angle, 99th percentile, mean at edges, mean elsewhere, mean albedo, its 99th]."""
    with Recovery(subject.domain, load_model("lambert"), schedule, seed, entry="fragment") as recovery:
        recovery.step(iterations=schedule.stages[0].iterations // 4)
        early = _angle(recovery.maps().values["normal"], subject.normal)
        recovery.step()
        values = recovery.maps().values
    angle = _angle(values["normal"], subject.normal)
    albedo = np.abs(values["base_color"] - subject.albedo).mean(axis=-1)
    elsewhere = angle[~subject.edge].mean()
    quantile = np.quantile(angle, 0.99)
    return np.array(
        [
            early.mean(),
            angle.mean(),
            quantile,
            angle[subject.edge].mean(),
            elsewhere,
            albedo.mean(),
            np.quantile(albedo, 0.99),
        ]
    )


def _angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return degrees between unit vectors, from the chord: the cosine has no precision at small angles."""
    return np.degrees(2 * np.arcsin(np.minimum(np.linalg.norm(a - b, axis=-1) / 2, 1)))


def cells(base: Schedule) -> list[tuple[str, int | None, float, Schedule]]:
    """Return (kind, H, c3, schedule) of every row of the table; without a neighbour term there is one row."""
    rows = [("none", None, 0.0, base.replaced(c3=0.0))]
    for kind, until in (("fading", 0.3), ("constant", 0.0)):
        for window in WINDOWS:
            for c3 in CONSTANTS:
                rows.append((kind, window, c3, base.replaced(neighbourhood=window, c3=c3, c3_fade=until)))
    return rows


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=40, help="texels along a side")
    parser.add_argument("--iterations", type=int, default=400)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--preset", default="swarm")
    options = parser.parse_args()
    context.ensure()
    subject = make_subject(options.size)
    base = load_schedule(options.preset).replaced(search=["all"], iterations=options.iterations, start="random")
    start = time.perf_counter()
    print(
        f"{options.size}² texels, {LIGHTS} lights, noise {NOISE}, preset {options.preset},"
        f" {options.iterations} iterations, mean over {options.seeds} seeds ± standard deviation;"
        f" {subject.edge.mean():.0%} of texels are edge.\n"
    )
    print("| c3 | | H | normal °, after ¼ | normal °, mean | 99th | at edges | elsewhere | albedo, mean | 99th |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    rows = cells(base)
    for number, (kind, window, c3, schedule) in enumerate(rows, 1):
        errors_by_seed = np.array([errors(subject, schedule, seed) for seed in range(options.seeds)])
        mean = errors_by_seed.mean(axis=0)
        print(
            f"| {c3:g} | {kind} | {window or '–'} | {mean[0]:.2f} | {mean[1]:.3f} ± {errors_by_seed[:, 1].std():.3f}"
            f" | {mean[2]:.2f} | {mean[3]:.3f} | {mean[4]:.3f} | {mean[5]:.5f} | {mean[6]:.4f} |",
            flush=True,
        )
        print(f"{number}/{len(rows)}, {time.perf_counter() - start:.0f} s", file=sys.stderr, flush=True)
    context.exit_process(0)


if __name__ == "__main__":
    main()
