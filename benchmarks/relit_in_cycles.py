"""Photographs beside what Cycles renders of a card's result under the same lights: a picture, and the PSNR of each.

Usage: python -m benchmarks.relit_in_cycles RESULT CAPTURE -o PICTURE.jpg [PHOTOGRAPH …]

RESULT is a folder that ``irpso recover CAPTURE -o RESULT --hold-out …`` wrote; shown are the photographs that it held
out, or those named, on the left, and its material.blend rendered by Cycles in the Standard view, on the right. For
distant lights.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from tempfile import TemporaryDirectory

import bpy
import numpy as np

from benchmarks.scenes import render
from benchmarks.scenes.card_captures import write_jpeg
from benchmarks.scenes.scores import psnr
from irpso_addon.blender.images import decode
from irpso_addon.capture.read import read_capture
from irpso_addon.capture.types import Light
from irpso_addon.core.encode import srgb_from_linear

_GAP = 6  # pixels between pictures
_SAMPLES = 64
_QUALITY = 80  # of the JPEG


def by_cycles(
    blend: Path, size: tuple[int, int], directions: np.ndarray, samples: int, filter_width: float | None = None
) -> np.ndarray:
    """Return (K, H, W, 3) radiance of the card in a .blend file under Suns of intensity 1, directions (K, 3).

    size: (width, height). filter_width: in pixels; None for Cycles' default.
    """
    bpy.ops.wm.open_mainfile(filepath=str(blend))
    scene = bpy.context.scene
    card = next(thing for thing in scene.objects if thing.type == "MESH")
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.type, camera.data.ortho_scale = "ORTHO", max(card.dimensions)
    camera.location = (*card.location[:2], card.location[2] + 10)
    scene.collection.objects.link(camera)
    scene.camera = camera
    render.set_up(scene, render.View(*size, samples=samples, bounces=0))
    if filter_width is not None:
        scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BLACKMAN_HARRIS", filter_width
    with TemporaryDirectory() as folder:
        return np.stack(list(render.photographs(Path(folder), directions, shadows=False)))


def rendered(blend: Path, size: tuple[int, int], lights: list[Light], intensities: list[list[float]]) -> np.ndarray:
    """Return (K, H, W, 3) radiance of the card in a .blend file under lights; size: (width, height)."""
    pictures = by_cycles(blend, size, np.array([light.vector for light in lights]), _SAMPLES)
    return pictures * np.array(intensities)[:, None, None]


def main() -> None:
    """Write the picture and print the PSNR, in dB of sRGB values, of each photograph."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("result", type=Path)
    parser.add_argument("capture", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("names", nargs="*", metavar="PHOTOGRAPH", help="all that were held out, without")
    options = parser.parse_args()
    report = json.loads((options.result / "report.json").read_text(encoding="utf-8"))
    capture = read_capture(options.capture, decoder=decode)
    names = [one.name for one in capture.observations]
    chosen = [names.index(name) for name in options.names or report["relighting_psnr_db"]]
    photographs = [srgb_from_linear(np.clip(capture.observations[k].read()[..., :3], 0, 1)) for k in chosen]
    height, width = photographs[0].shape[:2]
    lights = [capture.observations[k].light for k in chosen]
    shown = rendered(
        options.result / "material.blend", (width, height), lights, [report["lights"]["intensities"][k] for k in chosen]
    )
    renders = list(srgb_from_linear(np.clip(shown, 0, 1)))
    for k, seen, made in zip(chosen, photographs, renders, strict=True):
        print(f"{names[k]}: {psnr(seen, made, np.ones(seen.shape[:2], bool)):.1f} dB")
    rows = [
        np.concatenate([np.pad(p, [(_GAP, _GAP), (_GAP, _GAP), (0, 0)], constant_values=1.0) for p in pair], axis=1)
        for pair in zip(photographs, renders, strict=True)
    ]
    write_jpeg(options.output, np.concatenate(rows[::-1]), _QUALITY)


if __name__ == "__main__":
    main()
