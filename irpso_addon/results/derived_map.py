"""``DerivedMap``: maps computed from the recovered ones: normals in other spaces, heights, indirect light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.encode import FLAT_NORMAL, encode_normal, fill_margin
from ..geometry.relief.height import Height

NORMAL_SPACES = ("object", "world", "directx")


@dataclass(frozen=True)
class DerivedMap:
    """One map that is not a parameter of the model.

    name: file stem. values: (H, W, C) float32, row 0 at the bottom, for the EXR. encoded: the same in 0…1, for the
    16-bit PNG. text: the PNG's encoding, for the report. exr: whether to write an EXR.
    """

    name: str
    values: np.ndarray
    encoded: np.ndarray
    text: str
    exr: bool = True


def normal_maps(
    spaces: dict[str, np.ndarray], covered: np.ndarray, margin: np.ndarray | None = None
) -> list[DerivedMap]:
    """Return normal maps of other spaces, "object", "world" or "directx" → (H, W, 3) unit vectors, XYZ.

    For "directx" the vectors are those of the tangent-space map; its PNG has green inverted, and it has no EXR, whose
    vectors would be the same. Object and world space follow Blender's Normal Map node. margin: of the Maps with the
    tangent-space normals.
    """
    maps = []
    for space, vectors in spaces.items():
        flat = FLAT_NORMAL if space == "directx" else None
        values = fill_margin(vectors, covered, far=flat, keep=margin if space == "directx" else None)
        if space == "directx":
            encoded = encode_normal(values * np.array([1, -1, 1], np.float32))
            maps.append(DerivedMap("normal_directx", values, encoded, "0.5 * n + 0.5, DirectX (Y-)", exr=False))
        else:
            maps.append(DerivedMap(f"normal_{space}", values, encode_normal(values), f"0.5 * n + 0.5, {space} space"))
    return maps


def height_map(height: Height) -> DerivedMap:
    """Return the map of a relief: heights in the EXR, height / scale + midlevel in the PNG."""
    values = fill_margin(height.values[..., None], height.covered, far=(0.0,))
    encoded = np.clip(values / height.scale + height.midlevel, 0, 1)
    text = f"(height in {height.unit}) / {height.scale:.9g} + {height.midlevel:.9g}"
    return DerivedMap("height", values, encoded, text)


def indirect_map(share: np.ndarray, covered: np.ndarray) -> DerivedMap:
    """Return the map of the fraction (H, W) of indirect light in the photographs, 0…1."""
    values = fill_margin(share[..., None], covered, far=(0.0,))
    return DerivedMap("indirect", values, values, "indirect light / light of the photographs")
