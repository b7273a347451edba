"""Subjects of captures like DiLiGenT's, with their materials."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from . import subjects
from .materials import Finish

# Two colours of a finish.
_PAINT = (0.55, 0.45, 0.3), (0.4, 0.4, 0.42)
_BRONZE = (0.6, 0.38, 0.2), (0.5, 0.3, 0.15)


@dataclass(frozen=True)
class Scene:
    """A subject. mesh: function that makes it. finish: its material. fill: share of the picture that it may span.

    saturated: share of the subject's samples that the exposure clips. samples, denoise: of render.View.
    """

    mesh: Callable
    finish: Finish
    fill: float = 0.94
    saturated: float = 0.005
    samples: int = 16
    denoise: bool = False


def catalogue(head: Path | None) -> dict[str, Scene]:
    """Return name → scene. head: the .obj file of the scan, without which its scenes are missing."""
    return _made_scenes() | (_head_scenes(partial(subjects.scan, head)) if head is not None else {})


def _made_scenes() -> dict[str, Scene]:
    red = ((0.6, 0.12, 0.08),) * 2
    clay = (0.65, 0.5, 0.38), (0.3, 0.16, 0.1)
    glaze = (0.08, 0.25, 0.5), (0.75, 0.65, 0.45)
    brass = (0.9, 0.62, 0.3), (0.8, 0.5, 0.25)
    brass_finish = Finish(brass, (0.5, 0.5), 1.0)
    parts = Finish(((1, 1, 1),) * 2, (0.5, 0.5), attributes=True, scale=6)
    return {
        "ball_plastic": Scene(subjects.ball, Finish(red, (0.15, 0.15)), 0.76),
        "cat_clay": Scene(subjects.monkey, Finish(clay, (0.5, 0.5), specular=0.4, scale=5)),
        "pot_glaze": Scene(subjects.pot, Finish(glaze, (0.2, 0.2), specular=0.7, scale=3)),
        "goblet_satin": Scene(subjects.goblet, brass_finish, saturated=0.02, samples=8, denoise=True),
        "cow_metalpaint": Scene(subjects.monkey, Finish(_PAINT, (0.45, 0.45), 0.8), samples=8),
        "harvest_concave": Scene(subjects.harvest, parts, samples=8, denoise=True),
    }


def metal_scenes() -> dict[str, Scene]:
    """Return name → scene: open relief of metals and metal paints."""
    steel = (0.6, 0.6, 0.62), (0.45, 0.45, 0.46)
    return {
        "pot, metal paint": Scene(subjects.pot, Finish(_PAINT, (0.45, 0.45), 0.8), samples=8),
        "pot, bronze": Scene(subjects.pot, Finish(_BRONZE, (0.35, 0.35), 0.7), samples=8),
        "cow, steel": Scene(subjects.monkey, Finish(steel, (0.6, 0.6), 0.9), samples=8),
        "fruits, metal paint": Scene(subjects.harvest, Finish(_PAINT, (0.5, 0.5), 0.7), samples=8, denoise=True),
    }


def hollow_scenes() -> dict[str, Scene]:
    """Return name → scene: hollows of one colour, of several, and of none."""
    brass, mixed = (_made_scenes()[name] for name in ("goblet_satin", "harvest_concave"))
    goblets = {
        "copper": Finish(((0.95, 0.6, 0.5), (0.8, 0.45, 0.35)), (0.35, 0.35), 1.0),
        "rose, matt": Finish(((0.8, 0.4, 0.4), (0.7, 0.3, 0.32)), (0.7, 0.7)),
        "green enamel": Finish(((0.1, 0.45, 0.2), (0.15, 0.35, 0.15)), (0.15, 0.15)),
        "patina": Finish(((0.6, 0.42, 0.22), (0.2, 0.35, 0.28)), (0.5, 0.5), 0.8),
        "two glazes": Finish(((0.1, 0.25, 0.5), (0.75, 0.65, 0.45)), (0.25, 0.25), specular=0.7),
    }
    fruits = {
        "gold": Finish(((0.85, 0.6, 0.25), (0.7, 0.48, 0.2)), (0.4, 0.4), 1.0),
        "bronze": Finish(_BRONZE, (0.3, 0.3), 0.9),
        "terracotta": Finish(((0.7, 0.35, 0.22), (0.55, 0.25, 0.15)), (0.6, 0.6), specular=0.3),
        "marble": Finish(((0.7, 0.7, 0.7), (0.45, 0.45, 0.46)), (0.4, 0.4)),
    }
    return {
        "goblet, brass": brass,
        **{f"goblet, {name}": replace(brass, finish=finish) for name, finish in goblets.items()},
        **{f"fruits, {name}": replace(brass, mesh=subjects.harvest, finish=finish) for name, finish in fruits.items()},
        "fruits, seven materials": mixed,
    }


def _head_scenes(scan: Callable) -> dict[str, Scene]:
    velvet = {"Sheen Weight": 0.6, "Sheen Roughness": 0.4, "Diffuse Roughness": 0.8}
    coat = {"Coat Weight": 1.0, "Coat Roughness": 0.1}
    skin = {"Subsurface Weight": 0.6, "Subsurface Radius": (1.0, 0.35, 0.15), "Subsurface Scale": 0.05}
    fur = (0.5, 0.32, 0.18), (0.28, 0.14, 0.07)
    dark = (0.12, 0.1, 0.09), (0.05, 0.05, 0.06)
    pale = (0.75, 0.48, 0.38), (0.65, 0.36, 0.28)
    fur_finish = Finish(fur, (0.7, 0.7), specular=0.15, scale=6, extra=velvet, plain=False)
    skin_finish = Finish(pale, (0.4, 0.5), scale=6, extra=skin, plain=False)
    return {
        "bear_velvet": Scene(scan, fur_finish),
        "reading_mixed": Scene(scan, Finish(dark, (0.5, 0.5), extra=coat, plain=False), samples=8),
        "skin_sss": Scene(scan, skin_finish, samples=8, denoise=True),
    }
