"""OpenLIME's BRDF layer: images of kd, ks, normals and gloss for a Ward lobe, and the layer's options as JSON.

As in OpenLIME's LayerBRDF and ShaderBRDF (CNR-ISTI): the view is (0, 0, 1). Radiance is ``brightness`` times
(kd / π + ks · ward) n·l + ``kAmbient`` kd / π, with ward = exp(−tan²θ / α²) / (4 π α² √(n·l n·v)). With ``alphaLimits``
(a, b) and g(α) = 1 − α^¼, α = (1 − gloss (g(a) − g(b)) − g(b))⁴. A pixel with a grey normal has no normal and is
transparent.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from ..core.encode import encode_normal
from ..core.png import encode_png
from ..core.udim import tile_stem
from ..results.maps import split_maps
from ..results.report import plain, quantiles
from . import pixels
from .lobes import Fit, fit_ward
from .place import filled_folder
from .result import Result
from .surface import Surface, surface_of

_EXPONENT = 4  # of OpenLIME's gloss
# Least width: OpenLIME's shader draws nothing if (α n·h)² is below 1e-5. Greatest width of a lobe: 1.
_LOWEST, _HIGHEST = 0.005, 1.0
_OUTSIDE = 0.5
_GAMMA = 2.2
_AMBIENT = 1e-6  # of kAmbient: OpenLIME replaces 0, as a missing value, by 0.1


def write_openlime(result: Result, folder: str | Path, replace: bool = True) -> dict[str, Any]:
    """Write 8-bit images and info.json, one set per UDIM tile; return the errors of the fit.

    info.json holds a layer's options: ``new OpenLIME.Layer(info)``. replace: files of the same names. Raises InputError
    if the model's lobes are unknown or the folder cannot be written.
    """
    tiles = result.maps.tiles
    report: dict[str, Any] = {}
    with filled_folder(folder, replace) as place:
        for number, maps in split_maps(result.maps):
            surface = surface_of(maps)
            fit = fit_ward(surface, _LOWEST, _HIGHEST)
            widths = fit.alpha[maps.solved]
            low, high = (float(widths.min()), float(widths.max())) if widths.size else (_LOWEST, _HIGHEST)
            # Slightly apart even if all widths are equal.
            limits = [round(low * 0.999, 6), round(max(high, 1.01 * low) * 1.001, 6)]
            names = {}
            for channel, image in _images(surface, fit, limits, maps).items():
                names[channel] = f"{tile_stem(channel, number, tiles)}.png"
                encode_png(place / names[channel], image, bits=8)
            height, width = maps.solved.shape
            info = {
                "type": "brdf", "layout": "image", "channels": names, "colorspaces": {"kd": "srgb", "ks": "srgb"},
                "alphaLimits": limits, "brightness": math.pi, "gamma": _GAMMA, "kAmbient": _AMBIENT,
                "width": width, "height": height,
            }  # fmt: skip
            stem = tile_stem("info", number, tiles)
            (place / f"{stem}.json").write_text(json.dumps(info, indent=2) + "\n", encoding="utf-8")
            lit = maps.solved & (fit.strength > 0).any(axis=-1)
            report[stem] = {"alphaLimits": limits, "ward_error": plain(quantiles(fit.error[lit]))}
            if (clipped := (fit.strength[lit] > 1).any(axis=-1)).any():
                text = f"{stem}: the highlight of {clipped.mean():.2%} of the texels is too dark: ks holds at most 1"
                report.setdefault("warnings", []).append(text)
    return {"output": str(folder), **report}


def _images(surface: Surface, fit: Fit, limits: list[float], maps) -> dict[str, np.ndarray]:
    kd = surface.base_color * (1 - surface.metallic)[..., None]
    if surface.layered:
        # The base gets only the light that the dielectric transmits, here at normal incidence.
        kd = kd * (1 - surface.f0[..., None])
    return {
        "kd": pixels.colour(kd, maps),
        "ks": pixels.colour(fit.strength, maps),
        "normals": np.where(maps.solved[..., None], encode_normal(surface.normal), _OUTSIDE),
        "gloss": pixels.packed(maps, gloss_of(fit.alpha, limits)),
    }


def gloss_of(alpha: np.ndarray, limits: list[float]) -> np.ndarray:
    """Return gloss of Ward widths: 0 at the upper limit, 1 at the lower."""
    root = 1 / _EXPONENT
    matte, glossy = 1 - limits[1] ** root, 1 - limits[0] ** root
    return np.clip((1 - np.asarray(alpha) ** root - matte) / (glossy - matte), 0, 1)
