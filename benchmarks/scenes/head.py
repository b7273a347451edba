"""A face as a subject of benchmarks/gloss.py: the scan of Lee Perry-Smith, with wet and gilded patches painted on it.

The scan (Infinite-Realities, CC BY 3.0) has colour, normals and a specular map, but neither roughness nor metallic:
both are authored here. Skin is .5 to .35 rough, the smoother the brighter its specular map; PATCHES are painted over.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import bpy
import numpy as np
from mathutils import Matrix
from scipy.ndimage import gaussian_filter

from irpso_addon.blender.mesh import extract_mesh
from irpso_addon.blender.scenes.true_surface import TrueMaps, true_material
from irpso_addon.capture.camera import Camera
from irpso_addon.capture.types import Capture
from irpso_addon.geometry.build import domain_from_mesh
from irpso_addon.geometry.domain import Domain
from irpso_addon.geometry.surface.bake import bake_camera

from . import subjects
from .textured import BLEND, NAME, head_maps, save_blend

SCAN = "head_leeperrysmith"  # folder of the data
_TEXELS, _DETAIL = 256, 128  # of the maps, along a side; a texel is some 1.5 pixels, their detail 3
_SKIN = (0.35, 0.5)  # roughness
_HEIGHT = 3.9  # of the mesh in world units: the face is then as wide as the cards, 1.5 of the picture's 2
_FACE = (0.0, 0.8, 0.85)  # of the scaled mesh: its point at the origin, between the eyes and behind the nose
_BORDER = 1.0  # texels: standard deviation of the blur of a patch's border


@dataclass(frozen=True)
class _Patch:
    """An ellipse in texture space. metal: its linear colour, None for wet skin, which keeps its own colour."""

    middle: tuple[float, float]
    radii: tuple[float, float]
    roughness: float
    metal: tuple[float, float, float] | None = None


PATCHES = (
    _Patch((0.502, 0.535), (0.06, 0.022), 0.12),  # lips
    _Patch((0.508, 0.6), (0.022, 0.022), 0.15),  # tip of the nose
    _Patch((0.515, 0.865), (0.07, 0.035), 0.15),  # forehead
    _Patch((0.42, 0.62), (0.04, 0.055), 0.3, (0.9, 0.69, 0.31)),  # one cheek: gold
    _Patch((0.515, 0.795), (0.1, 0.022), 0.25, (0.56, 0.55, 0.53)),  # a band above the brows: steel
)


@dataclass(frozen=True)
class Head:
    """The painted head. scan: the .obj file. maps: the true ones."""

    scan: Path
    maps: TrueMaps
    side: ClassVar[int] = 192  # pixels of a picture
    flat: ClassVar[bool] = False
    fine: ClassVar[bool] = False  # maps are interpolated between texels that are wider than pixels

    @property
    def digest(self) -> bytes:
        """Bytes that identify this head."""
        maps = (np.round(a, 6).astype(np.float32).tobytes() for a in vars(self.maps).values() if a is not None)
        return b"".join((*maps, repr((_HEIGHT, _FACE, self.side)).encode()))

    def build(self, maps: TrueMaps | None = None) -> None:
        """Put the head into the open scene, its face at the origin, with its true maps or with recovered ones."""
        made = subjects.scan(self.scan, 1)
        made.name = NAME
        subjects.fit(made, np.inf, _HEIGHT)
        made.data.transform(Matrix.Translation([-v for v in _FACE]))
        made.data.materials.append(true_material(self.maps if maps is None else maps))

    def truth(self, as_seen: TrueMaps) -> TrueMaps:
        """Return the true maps of the recovered texels."""
        return self.maps

    def points(self, camera: Camera) -> np.ndarray:
        """Return (side, side, 3), the pixels' points on the open scene's head."""
        return bake_camera(extract_mesh(bpy.data.objects[NAME]), camera).position

    def arguments(self, folder: Path, shadows: bool) -> tuple[object, ...]:
        """Save the open scene's head without material into the folder; return the arguments of ``recover`` for it."""
        bpy.data.objects[NAME].data.materials.clear()
        save_blend(folder)
        mesh = "--blend", folder / BLEND, "--object", NAME, "--resolution", _TEXELS
        return mesh if shadows else (*mesh, "--no-shadows")

    def domain(self, capture: Capture, shadows: bool) -> Domain:
        """Return the domain of a capture of the open scene's head."""
        return domain_from_mesh(capture, extract_mesh(bpy.data.objects[NAME]), _TEXELS, _TEXELS, shadows=shadows)


def head(folder: Path) -> Head:
    """Return the painted head from the scan's folder."""
    scan = head_maps(folder, _TEXELS, _DETAIL)
    low, high = scan.roughness.min(), scan.roughness.max()
    roughness = np.interp(scan.roughness, (low, high), _SKIN)
    colour, metallic = scan.base_color.copy(), np.zeros_like(roughness)
    for patch in PATCHES:
        share = _share(patch)
        roughness += share * (patch.roughness - roughness)
        if patch.metal is not None:
            metallic += share * (1 - metallic)
            colour += share[..., None] * (patch.metal - colour)
    return Head(folder / "LeePerrySmith.obj", TrueMaps(colour, scan.normal, roughness, metallic))


def _share(patch: _Patch) -> np.ndarray:
    """Return (_TEXELS, _TEXELS) 1 inside a patch and 0 outside."""
    along = (np.arange(_TEXELS) + 0.5) / _TEXELS
    v, u = np.meshgrid(along, along, indexing="ij")
    (x, y), (wide, high) = patch.middle, patch.radii
    return gaussian_filter((np.hypot((u - x) / wide, (v - y) / high) < 1).astype(float), _BORDER)
