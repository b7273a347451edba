"""Materials recovered from what Cycles rendered, against the true ones: a table of errors and of relit pictures.

Usage: python -m benchmarks.cycles_scenes --data FOLDER [--preset standard …] [--cache .cache/scenes] [-o OUT] [NAME …]

FOLDER holds the scan (head_leeperrysmith) and the materials (materials/rock, materials/mossyrock). Each scene is a mesh
with UVs and true maps, photographed by Cycles (an independent renderer; cast shadows, four bounces) under 40 lights and
handed to the public command ``python -m irpso_addon recover``. The maps it writes are compared texel by texel, and the
material that it writes is rendered by Cycles under 10 lights that were not in the capture. PSNR and SSIM (Wang et al.
2004) are of pictures in sRGB (the Standard view), over the subject. Pictures stay in the cache: empty it after changing
a mesh or a map.

The true maps are reduced to --detail texels along a side, so that pictures of --size pixels resolve them. With as much
detail as texels, what is recovered is nearest to the truth blurred by .6 texels: on the rock monkey 2.5° of median
against 4.0° without the blur, the pictures' limit and not the fit's.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from benchmarks.scenes import render, textured
from benchmarks.scenes.command import ROOT, recover
from benchmarks.scenes.lights import seen_and_unseen
from benchmarks.scenes.scores import Errors, angles, psnr, ssim
from irpso_addon.blender.scenes.true_surface import TrueMaps
from irpso_addon.capture.images.exr import read_exr
from irpso_addon.core.encode import srgb_from_linear
from irpso_addon.core.png import encode_png
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.read import read_maps


@dataclass(frozen=True)
class Result:
    """One recovery. normal: degrees. base_color, roughness: absolute differences. psnr (dB), ssim: per unseen light."""

    scene: str
    preset: str
    texels: int
    seconds: float
    normal: Errors
    base_color: Errors
    roughness: Errors
    psnr: np.ndarray
    ssim: np.ndarray


def measure(name: str, scene: textured.TexturedScene, presets: list[str], options: argparse.Namespace) -> list[Result]:
    """Photograph a scene, recover it with every preset, and compare."""
    view = render.View(options.size, options.size, samples=options.samples)
    directions, unseen = seen_and_unseen()
    key = repr((scene.note, view, options.resolution, options.detail, directions.tobytes(), unseen.tobytes()))
    folder = options.cache / f"{name}-{hashlib.sha256(key.encode()).hexdigest()[:10]}"
    truth = scene.maps(options.resolution, options.detail)
    textured.prepare(scene, view, folder)
    true_pictures, mask = textured.photograph(truth, view, folder, directions, unseen)
    results = []
    for preset in presets:
        out = options.out / f"{name}-{Path(preset).stem}"
        mesh = "--blend", folder / textured.BLEND, "--object", textured.NAME, "--resolution", options.resolution
        seconds = recover(folder / textured.CAPTURE, out, *mesh, "--preset", preset)
        errors, texels = map_errors(out, truth)
        pictures = textured.photograph_result(out / "material.blend", view, out / "relit", unseen)
        shown, relit = (srgb_from_linear(np.clip(p, 0, 1)) for p in (true_pictures, pictures))
        compared = [(psnr(a, b, mask), ssim(a, b, mask)) for a, b in zip(relit, shown, strict=True)]
        encode_png(out / "relit.png", side_by_side(relit, shown), bits=8)
        results.append(Result(name, Path(preset).stem, texels, seconds, *errors, *np.array(compared).T))
    return results


def side_by_side(below: np.ndarray, above: np.ndarray, count: int = 4) -> np.ndarray:
    """Return one picture of the first ``count`` pictures of two series (K, H, W, 3), in two rows."""
    return np.concatenate([np.concatenate(list(series[:count]), axis=1) for series in (below, above)])


def map_errors(out: Path, truth: TrueMaps) -> tuple[tuple[Errors, Errors, Errors], int]:
    """Return the errors of normal, base colour and roughness at the texels that the camera sees, and their number."""
    maps = read_maps(out, load_model("principled"))
    (coverage,) = read_exr(out / "maps.exr")["coverage"].values()
    seen = coverage > 0
    colour = np.abs(maps["base_color"] - truth.base_color).mean(axis=-1)
    rough = np.abs(maps["roughness"][..., 0] - truth.roughness)
    normal = angles(maps["normal"], truth.normal)
    return tuple(Errors.of(values[seen]) for values in (normal, colour, rough)), int(seen.sum())


def markdown(results: list[Result]) -> str:
    """Return the table."""
    lines = [
        "| scene | preset | texels | s | normal ° mean | median | 95 % | base colour mean | median"
        " | roughness mean | median | PSNR dB mean | least | SSIM mean | least |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for r in results:
        lines.append(
            f"| {r.scene} | {r.preset} | {r.texels} | {r.seconds:.0f} | {r.normal.mean:.2f} | {r.normal.median:.2f}"
            f" | {r.normal.p95:.2f} | {r.base_color.mean:.4f} | {r.base_color.median:.4f} | {r.roughness.mean:.3f}"
            f" | {r.roughness.median:.3f} | {r.psnr.mean():.1f} | {r.psnr.min():.1f} | {r.ssim.mean():.4f}"
            f" | {r.ssim.min():.4f} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Print the table, and write it with its numbers into the output folder."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="scenes; all without")
    parser.add_argument("--data", type=Path, required=True, help="folder with materials/ and head_leeperrysmith/")
    parser.add_argument("--preset", action="append", help="may be given several times")
    parser.add_argument("--cache", type=Path, default=ROOT / ".cache" / "scenes", help="folder that keeps the pictures")
    parser.add_argument(
        "-o", "--out", type=Path, help="folder for the recovered maps (default: recovered, in the cache)"
    )
    parser.add_argument("--size", type=int, default=256, help="pixels along a side of the pictures")
    parser.add_argument(
        "--resolution", type=int, default=256, help="texels along a side of the maps, a divisor of 1024"
    )
    parser.add_argument("--detail", type=int, default=128, help="texels along a side that the true maps really have")
    parser.add_argument("--samples", type=int, default=32, help="for each pixel and light")
    options = parser.parse_args()
    options.out = options.out or options.cache / "recovered"
    scenes = textured.scene_table(options.data)
    if unknown := set(options.names) - set(scenes):
        parser.error(f"unknown: {', '.join(sorted(unknown))}; choose from {', '.join(scenes)}")
    results = []
    for name in options.names or scenes:
        results += measure(name, scenes[name], options.preset or ["standard"], options)
        sys.stderr.write(f"{markdown(results[-1:]).splitlines()[-1]}\n")
    notes = [f"{name}: {scenes[name].note}." for name in options.names or scenes if scenes[name].note]
    table = "\n".join([markdown(results), "", *notes])
    (options.out / "cycles_scenes.md").write_text(table + "\n", encoding="utf-8")
    numbers = json.dumps([asdict(result) for result in results], indent=1, default=np.ndarray.tolist)
    (options.out / "cycles_scenes.json").write_text(numbers, encoding="utf-8")
    print(table)


if __name__ == "__main__":
    main()
