"""Captures like those of DiLiGenT, photographed by Cycles: cast shadows, interreflection, highlights that saturate.

Usage: python -m benchmarks.scenes.capture [--cache .cache/scenes] [--head FOLDER] [-o OUT] [NAME …]

Each subject gets a folder in the layout of DiLiGenT with normal_gt.exr, base_color_gt.exr and, where the material has
one roughness, roughness_gt.exr. Pictures in the cache are not rendered again: empty it after changing a mesh.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
import time
from pathlib import Path

import numpy as np

from irpso_addon.capture.images.exr import read_exr, write_exr
from irpso_addon.core.png import encode_png
from irpso_addon.sample.sensor import Sensor

from . import lights, materials, render, subjects
from .catalogue import Scene, catalogue

CACHE = Path(__file__).resolve().parents[2] / ".cache" / "scenes"
_INTENSITIES = (1.5, 6.0)


def make(title: str, scene: Scene, size: tuple[int, int], cache: Path, out: Path, bounces: int = 4) -> int:
    """Render what the cache lacks and write the capture into ``out``; return the number of its mask's texels."""
    view = render.View(*size, samples=scene.samples, denoise=scene.denoise, bounces=bounces)
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
    sensor = Sensor(gain=float(1 / np.quantile(brightest, 1 - scene.saturated)))
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
        values = np.where(mask[..., None], maps[name], 0).astype(np.float32)
        write_exr(out / f"{name}_gt.exr", {"": {c: values[..., i] for i, c in enumerate("RGB")}})
    if plain:
        values = np.where(mask, maps["roughness"], 0).astype(np.float32)
        write_exr(out / "roughness_gt.exr", {"": {"Y": values}})


def read_truth(folder: Path, name: str) -> np.ndarray:
    """Return (H, W, 3), a capture's true normals or colours, row 0 at the bottom."""
    (channels,) = read_exr(folder / f"{name}_gt.exr").values()
    return np.stack([channels[c] for c in "RGB"], axis=-1)


def folder_name(title: str) -> str:
    """Return a subject's title as the name of its folder."""
    return title.replace(", ", "-").replace(" ", "-")


def _digest(*settings) -> str:
    return hashlib.sha256(repr(settings).encode()).hexdigest()[:10]


def main() -> None:
    """Make the named captures, or all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="subjects; all without")
    parser.add_argument("--cache", type=Path, default=CACHE, help="folder that keeps the pictures")
    parser.add_argument("--head", type=Path, help="folder of the head scan; without it its subjects are left out")
    parser.add_argument("--size", default="300x250", help="pixels, WxH")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder for the captures")
    options = parser.parse_args()
    width, height = map(int, options.size.split("x"))
    scenes = catalogue(options.head and options.head / "LeePerrySmith.obj")
    if unknown := set(options.names) - set(scenes):
        parser.error(f"unknown: {', '.join(sorted(unknown))}; choose from {', '.join(scenes)}")
    for name in options.names or scenes:
        started = time.perf_counter()
        texels = make(name, scenes[name], (width, height), options.cache, options.out / name)
        sys.stderr.write(f"{name}: {texels} texels, {time.perf_counter() - started:.0f} s\n")


if __name__ == "__main__":
    main()
