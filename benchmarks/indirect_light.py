"""Interreflection of hollow bodies from their true maps: gathered by the program, and baked by Cycles.

Usage: python -m benchmarks.indirect_light [--quick] [--samples 16,64] [--cache .cache/hollows] [NAME …]

The bodies are those of benchmarks/scenes/hollows.py. The reference is what Cycles renders for four of the 40 lights, by
default with 256 samples a pixel and 8 bounces, projected to the texels. *Gather* is the program's estimate
(solver/interreflection/indirect_light.py) by the settings of the preset *thorough*, or with as many bounces as the
reference. *Bake* is Cycles' bake of indirect light, viewed from the camera, one for each light, with its own seed.
Seconds are of all cores together (CPU time), for 40 lights. Ratio: of the sums over texels and lights. Error: the mean
absolute one over the mean of the reference.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterable
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path

import bpy
import numpy as np

from benchmarks import report
from benchmarks.scenes import hollows, materials, render
from benchmarks.scenes.textured import BLEND, CAPTURE, NAME, opaque
from irpso_addon.blender.images import decode
from irpso_addon.blender.mesh import extract_mesh
from irpso_addon.blender.ray_caster import ray_caster
from irpso_addon.capture.read import read_capture
from irpso_addon.capture.types import Observation
from irpso_addon.core.steps import run_steps
from irpso_addon.geometry.build import domain_from_mesh
from irpso_addon.geometry.domain import Domain
from irpso_addon.geometry.light.light_transport import light_transport_steps
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.interreflection.indirect_light import IndirectLight
from irpso_addon.solver.settings.schedule import load_schedule

_CACHE = report.CACHE.parent / "hollows"
_CHOSEN = (0, 13, 26, 39)  # lights of the reference, from the middle of the dome to its rim
_BOUNCES = hollows.BOUNCES
_INDIRECT = {"INDIRECT", "DIFFUSE", "GLOSSY"}
_MODEL = "metallic_roughness"


class Body:
    """A body of hollows.py in the open file, its domain, and the reference (4, T, 3) at the covered texels."""

    def __init__(self, name: str, quick: bool, cache: Path):
        side, self.texels, photographed, samples = (40, 24, 2, 4) if quick else (128, 80, 64, 256)
        self.body = hollows.HOLLOWS[name]
        folder = hollows.photograph(name, self.body, _BOUNCES, side, photographed, cache)
        self.capture = read_capture(folder / CAPTURE, decoder=decode)
        bpy.ops.wm.open_mainfile(filepath=str(folder / BLEND))
        self.thing = bpy.data.objects[NAME]
        self.mesh = extract_mesh(self.thing)
        self.domain = self._projected(self.capture.observations)
        self.thing.data.materials.append(materials.build(self.body.finish))
        self.view = render.View(side, side, samples=samples, bounces=_BOUNCES, clamp=0.0, filter_glossy=0.0)
        taken = [self._photographed(folder / f"reference-{samples}-{n}", n) for n in (_BOUNCES, 0)]
        self.reference = taken[0] - taken[1]
        weight = np.stack([self.domain.stack.layer(number)[..., 3] for number in _CHOSEN])
        self.counted = ((weight > 0) & self.domain.solvable)[:, self.domain.bake.coverage]

    def gathered(self, bounces: int) -> np.ndarray:
        """Return (40, T, 3), the light that the program gathers from the true maps."""
        settings, domain, model = load_schedule("thorough").interreflection, self.domain, load_model(_MODEL)
        true = {
            "base_color": self.body.color, "normal": (0, 0, 1), "roughness": (self.body.roughness,),
            "metallic": (self.body.metallic,), "specular": (0.5,),
        }  # fmt: skip
        maps = {name: np.broadcast_to(np.float32(value), (*domain.shape, len(value))) for name, value in true.items()}
        steps = light_transport_steps(
            self.mesh, domain.bake, domain.lights, ray_caster(self.mesh), settings.resolution, settings.rays
        )
        with closing(IndirectLight(domain, run_steps(steps), model, maps, domain.solvable, bounces)) as light:
            radiance, _ = run_steps(light.of_elements())
            samples, covered = light.samples(radiance), np.nonzero(light.covered)
            return np.stack([samples.at(k, *covered) for k in range(domain.observations)])

    def baked(self, samples: int) -> np.ndarray:
        """Return (40, T, 3), the light that Cycles bakes with the true material; the lights are distant."""
        scene = bpy.context.scene
        render.set_up(scene, replace(self.view, samples=samples))
        scene.render.use_persistent_data = True
        scene.render.bake.view_from, scene.render.bake.margin = "ACTIVE_CAMERA", 0
        image = bpy.data.images.new("indirect", self.texels, self.texels, alpha=True, float_buffer=True, is_data=True)
        nodes = self.thing.data.materials[0].node_tree.nodes
        nodes.active = nodes.new("ShaderNodeTexImage")
        nodes.active.image = image
        self.thing.select_set(True)
        bpy.context.view_layer.objects.active = self.thing
        light, pixels = [], np.empty((self.texels, self.texels, 4), np.float32)
        for number, _ in enumerate(render.lamps(self.domain.lights[:, :3])):
            scene.cycles.seed = number
            bpy.ops.object.bake(type="COMBINED", pass_filter=_INDIRECT)
            image.pixels.foreach_get(pixels.ravel())
            light.append(pixels[self.domain.bake.coverage, :3])
        return np.stack(light)

    def compared(self, radiance: np.ndarray) -> list[str]:
        """Return the ratio and the error of (40, T, 3), in words."""
        mine, true = (part.mean(axis=-1)[self.counted] for part in (radiance[list(_CHOSEN)], self.reference))
        return [f"{mine.sum() / true.sum():.3f}", f"{100 * np.abs(mine - true).sum() / true.sum():.0f} %"]

    def _photographed(self, folder: Path, bounces: int) -> np.ndarray:
        """Return (4, T, 3), the radiance of the covered texels under the chosen lights."""
        render.set_up(bpy.context.scene, replace(self.view, bounces=bounces))
        pictures = render.photographs(folder, self.domain.lights[list(_CHOSEN), :3])
        taken = [
            replace(self.capture.observations[number], read=partial(opaque, picture))
            for number, picture in zip(_CHOSEN, pictures, strict=True)
        ]
        layers = self._projected(taken).stack.layers()
        return np.stack([layer[self.domain.bake.coverage, :3] for layer in layers])

    def _projected(self, observations: Iterable[Observation]) -> Domain:
        capture = replace(self.capture, observations=tuple(observations))
        return domain_from_mesh(capture, self.mesh, self.texels, self.texels)


def rows(name: str, quick: bool, samples: Iterable[int], cache: Path) -> list[list[str]]:
    """Return the rows of one body's table."""
    body = Body(name, quick, cache)
    ways: list[tuple[str, Callable[[], np.ndarray]]] = [
        *((f"gather, {bounces} bounces", partial(body.gathered, bounces)) for bounces in (_usual(), _BOUNCES)),
        *((f"bake, {count} samples", partial(body.baked, count)) for count in samples),
    ]
    table = []
    for title, way in ways:
        started = time.process_time()
        light = way()
        table.append([name, title, f"{time.process_time() - started:.0f}", *body.compared(light)])
        report.say(" ".join(table[-1]))
    return table


def _usual() -> int:
    """Return the bounces of the preset *thorough*."""
    return load_schedule("thorough").interreflection.bounces


def main(arguments: list[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Gathered and baked indirect light, beside rendered")
    parser.add_argument("--quick", action="store_true", help="tiny sizes, to see that it runs")
    parser.add_argument("--samples", default="16,64", help="of the bakes")
    parser.add_argument("--cache", type=Path, default=_CACHE)
    parser.add_argument("names", nargs="*", default=list(hollows.HOLLOWS))
    options = parser.parse_args(arguments)
    samples = [int(count) for count in options.samples.split(",")]
    table = [row for name in options.names for row in rows(name, options.quick, samples, options.cache)]
    sys.stdout.write("\n".join(report.table(["body", "light", "CPU s", "ratio", "error"], table)) + "\n")


if __name__ == "__main__":
    from irpso_addon.gpu import context

    main()
    context.exit_process(0)
