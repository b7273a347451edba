"""Captures like those of DiLiGenT, photographed by Cycles: cast shadows, interreflection, highlights that saturate.

Usage: python -m benchmarks.scenes.capture [--cache .cache/scenes] [--head FOLDER] [--samples 16] [-o OUT] [NAME …]

Each subject gets a folder in the layout of DiLiGenT with normal_gt.exr, base_color_gt.exr and, where the material has
one roughness, roughness_gt.exr. Pictures in the cache are not rendered again: empty it after changing a mesh.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from irpso_addon.capture.exr import write_exr
from irpso_addon.maps.blender_images import encode_png

from . import lights, materials, render, subjects
from .materials import Finish
from .sensor import Sensor

CACHE = Path(__file__).resolve().parents[2] / ".cache" / "scenes"
_SATURATED = 0.005  # the share of the subject's samples that one exposure for all pictures burns out
_INTENSITIES = (1.5, 6.0)


@dataclass(frozen=True)
class Scene:
    """mesh: makes the subject. finish: its material. fill: the share of the picture that it may span."""

    mesh: Callable
    finish: Finish
    fill: float = 0.94


def catalogue(head: Path | None) -> dict[str, Scene]:
    """Return name → scene; those of the head only where the .obj file of its scan is given."""
    scenes = {
        "ball_plastic": Scene(subjects.ball, Finish(((0.6, 0.12, 0.08),) * 2, (0.15, 0.15)), 0.76),
        "cat_clay": Scene(
            subjects.monkey, Finish(((0.65, 0.5, 0.38), (0.3, 0.16, 0.1)), (0.5, 0.5), specular=0.4, scale=5)
        ),
        "pot_glaze": Scene(
            subjects.pot, Finish(((0.08, 0.25, 0.5), (0.75, 0.65, 0.45)), (0.2, 0.2), specular=0.7, scale=3)
        ),
        "goblet_metal": Scene(subjects.goblet, Finish(((0.9, 0.62, 0.3), (0.8, 0.5, 0.25)), (0.35, 0.35), 1.0)),
        "cow_metalpaint": Scene(subjects.monkey, Finish(((0.55, 0.45, 0.3), (0.4, 0.4, 0.42)), (0.45, 0.45), 0.8)),
        "harvest_concave": Scene(subjects.harvest, Finish(((1, 1, 1),) * 2, (0.5, 0.5), attributes=True, scale=6)),
    }
    if head is not None:
        scan = partial(subjects.scan, head)
        velvet = {"Sheen Weight": 0.6, "Sheen Roughness": 0.4, "Diffuse Roughness": 0.8}
        coat = {"Coat Weight": 1.0, "Coat Roughness": 0.1}
        skin = {"Subsurface Weight": 0.6, "Subsurface Radius": (1.0, 0.35, 0.15), "Subsurface Scale": 0.05}
        scenes |= {
            "bear_velvet": Scene(
                scan,
                Finish(
                    ((0.5, 0.32, 0.18), (0.28, 0.14, 0.07)),
                    (0.7, 0.7),
                    specular=0.15,
                    scale=6,
                    extra=velvet,
                    plain=False,
                ),
            ),
            "reading_mixed": Scene(
                scan, Finish(((0.12, 0.1, 0.09), (0.05, 0.05, 0.06)), (0.5, 0.5), extra=coat, plain=False)
            ),
            "skin_sss": Scene(
                scan, Finish(((0.75, 0.48, 0.38), (0.65, 0.36, 0.28)), (0.4, 0.5), scale=6, extra=skin, plain=False)
            ),
        }
    return scenes


def make(title: str, scene: Scene, view: render.View, cache: Path, out: Path) -> int:
    """Render what the cache lacks and write the capture into ``out``; return the number of texels of its mask."""
    directions = lights.grid_lights()
    intensities = lights.uneven_intensities(len(directions), *_INTENSITIES)
    render.empty_scene(view)
    subject = scene.mesh()
    tall = view.world_width * view.height / view.width
    subjects.fit(subject, scene.fill * view.world_width, scene.fill * tall)
    subject.data.materials.append(materials.build(scene.finish))
    folder = cache / f"{title}-{_digest(scene.finish, scene.fill, view, directions.tobytes())}"
    maps = render.truth(folder)
    mask = maps["coverage"] > 0.999
    out.mkdir(parents=True, exist_ok=True)
    names = [f"{n + 1:03d}.png" for n in range(len(directions))]
    pictures = [
        radiance * intensity
        for radiance, intensity in zip(render.photographs(folder, directions), intensities, strict=True)
    ]
    brightest = np.stack([picture[mask].max(axis=-1) for picture in pictures])
    sensor = Sensor(gain=float(1 / np.quantile(brightest, 1 - _SATURATED)))
    for seed, (name, picture) in enumerate(zip(names, pictures, strict=True)):
        encode_png(out / name, sensor.expose(picture, seed))
    encode_png(out / "mask.png", mask.astype(float), bits=8)
    (out / "filenames.txt").write_text("\n".join(names) + "\n")
    np.savetxt(out / "light_directions.txt", directions, "%.8f")
    np.savetxt(out / "light_intensities.txt", intensities, "%.6f")
    _write_truth(maps, mask, scene.finish.plain, out)
    return int(mask.sum())


def _write_truth(maps: dict[str, np.ndarray], mask: np.ndarray, plain: bool, out: Path) -> None:
    for name in ("normal", "base_color"):
        kept = np.where(mask[..., None], maps[name], 0).astype(np.float32)
        write_exr(out / f"{name}_gt.exr", {"": {c: kept[..., i] for i, c in enumerate("RGB")}})
    if plain:
        kept = np.where(mask, maps["roughness"], 0).astype(np.float32)
        write_exr(out / "roughness_gt.exr", {"": {"Y": kept}})


def _digest(*settings) -> str:
    return hashlib.sha256(repr(settings).encode()).hexdigest()[:10]


def main() -> None:
    """Make the captures that are named, or all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="subjects; all without")
    parser.add_argument("--cache", type=Path, default=CACHE, help="folder that keeps the pictures")
    parser.add_argument("--head", type=Path, help="folder of the head scan; without it its subjects are left out")
    parser.add_argument("--size", default="300x250", help="pixels, WxH")
    parser.add_argument("--samples", type=int, default=16, help="for each pixel and light")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder for the captures")
    options = parser.parse_args()
    width, height = map(int, options.size.split("x"))
    view = render.View(width, height, samples=options.samples)
    scenes = catalogue(options.head and options.head / "LeePerrySmith.obj")
    if unknown := set(options.names) - set(scenes):
        parser.error(f"unknown: {', '.join(sorted(unknown))}; choose from {', '.join(scenes)}")
    for name in options.names or scenes:
        started = time.perf_counter()
        texels = make(name, scenes[name], view, options.cache, options.out / name)
        sys.stderr.write(f"{name}: {texels} texels, {time.perf_counter() - started:.0f} s\n")


if __name__ == "__main__":
    main()
