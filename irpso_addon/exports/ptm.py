"""Polynomial texture maps: the appearance under any light, as six coefficients per texel and channel.

The format is version 1.2 of Malzbender & Gelb 2001, Polynomial Texture Map (.ptm) File Format. Six lines of text hold
version, format, width, height, scales and biases. Then red, green and blue follow, each with six bytes per pixel, the
lowest row first. A coefficient is (byte − bias) · scale. Under a light of direction (lu, lv, …) a channel, 0…255, is
a₀ lu² + a₁ lv² + a₂ lu lv + a₃ lu + a₄ lv + a₅. Viewers show this value directly, so it is fitted to sRGB-encoded,
clipped pixels, like those of a photograph.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..core.encode import srgb_from_linear
from ..core.files import replacing_file
from ..core.udim import tile_stem
from ..geometry.domain import flat_bake
from ..results.maps import Maps, split_maps
from ..solver.views.forward import Renderer
from .place import check_replaced
from .result import Result

_LIGHTS = 64
_WIDEST = 80.0  # degrees from the normal


def write_ptm(result: Result, path: str | Path, replace: bool = True) -> dict[str, Any]:
    """Write NAME.ptm, one per UDIM tile; return the PSNR (dB) of the polynomials against their reference renders.

    The result's own shader renders the reference, so every model can be written. replace: existing files. Raises
    InputError or GpuUnavailableError.
    """
    path, report = Path(path), {}
    parts = list(split_maps(result.maps))
    files = [path.with_name(f"{tile_stem(path.stem, number, result.maps.tiles)}.ptm") for number, _ in parts]
    check_replaced(files, replace)
    for file, (_, maps) in zip(files, parts, strict=True):
        lights = even_lights(_LIGHTS, _WIDEST)
        basis = polynomial(lights)
        renderer = card_renderer(maps, lights)
        try:
            coefficients = _fitted(renderer, basis)
            codes, scale, bias = quantised(coefficients)
            shown = (codes - bias) * scale
            report[file.name] = {"lights": _LIGHTS, "psnr_db": round(_psnr(renderer, basis, shown, maps.solved), 2)}
        finally:
            renderer.close()
        with replacing_file(file) as partial:
            partial.write_bytes(ptm_bytes(codes, scale, bias))
    return {"output": str(path), **report}


def even_lights(count: int, widest: float) -> np.ndarray:
    """Return (count, 3) directions on a spiral, even over the disc of (lu, lv), up to ``widest`` degrees from +z."""
    radius = np.sin(np.radians(widest)) * np.sqrt((np.arange(count) + 0.5) / count)
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1 - radius**2)], axis=-1)


def polynomial(lights: np.ndarray) -> np.ndarray:
    """Return (K, 6) the terms of Malzbender, Gelb & Wolters 2001, Eq. 1, of light directions (K, 3)."""
    u, v = lights[:, 0], lights[:, 1]
    return np.stack([u * u, v * v, u * v, u, v, np.ones_like(u)], axis=-1)


def quantised(coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return bytes (H, W, 3, 6), scales (6,) and whole biases (6,) of coefficients (H, W, 3, 6)."""
    low, high = (getattr(coefficients, which)(axis=(0, 1, 2)).astype(np.float64) for which in ("min", "max"))
    # 254 of 255 steps: rounding the bias can shift the codes by up to one.
    scale = np.where(high > low, (high - low) / 254, 1.0)
    bias = np.rint(-low / scale)
    return np.clip(np.rint(coefficients / scale) + bias, 0, 255).astype(np.uint8), scale, bias.astype(np.int64)


def ptm_bytes(codes: np.ndarray, scale: np.ndarray, bias: np.ndarray) -> bytes:
    """Return the file for bytes (H, W, 3, 6), row 0 at the bottom, with their scales and biases."""
    height, width = codes.shape[:2]
    scales, biases = " ".join(f"{value:.9g}" for value in scale), " ".join(str(int(value)) for value in bias)
    head = f"PTM_1.2\nPTM_FORMAT_RGB\n{width}\n{height}\n{scales}\n{biases}\n"
    return head.encode("ascii") + np.moveaxis(codes, 2, 0).tobytes()


def card_renderer(maps: Maps, lights: np.ndarray) -> Renderer:
    """Return the renderer of maps on a flat card, seen straight from above; lights: (K, 3), toward distant lights."""
    height, width = maps.solved.shape
    x, y = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    bake = flat_bake(np.stack([x, y, np.zeros_like(x)], axis=-1), maps.solved, np.stack([x, y], axis=-1))
    values = {
        p.name: np.broadcast_to(
            np.asarray(maps.values.get(p.name, p.default), np.float32), (height, width, p.components)
        )
        for p in maps.model.parameters
    }
    count = len(lights)
    table = np.concatenate([lights, np.zeros((count, 1))], axis=1)
    views = np.tile([0.0, 0.0, 1.0, 0.0], (count, 1))
    return Renderer(bake, maps.model, values, table, np.ones((count, 3)), views, card=True)


def _pictures(renderer: Renderer, count: int) -> Iterator[np.ndarray]:
    for k in range(count):
        yield 255 * np.minimum(srgb_from_linear(renderer.render(k)[..., :3]), 1)


def _fitted(renderer: Renderer, basis: np.ndarray) -> np.ndarray:
    """Return (H, W, 3, 6) least-squares coefficients."""
    solve = np.linalg.pinv(basis)
    total = 0.0
    for k, picture in enumerate(_pictures(renderer, len(basis))):
        total = total + picture[..., None] * solve[:, k].astype(np.float32)
    return total


def _psnr(renderer: Renderer, basis: np.ndarray, shown: np.ndarray, covered: np.ndarray) -> float:
    """Return the PSNR (dB) of a viewer's image, clipped to 0…255, over the solved texels and all lights."""
    squared = 0.0
    for k, picture in enumerate(_pictures(renderer, len(basis))):
        difference = np.clip(shown @ basis[k], 0, 255) - picture
        squared += float((difference[covered] ** 2).mean()) / len(basis)
    return float(10 * np.log10(255**2 / max(squared, 1e-12)))
