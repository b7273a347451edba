"""Flat cards of glossy and metallic materials: maps from numpy, and the displaced mesh that carries them.

A card fills a picture of SIDE × SIDE pixels: one texel is one pixel. Maps have MARGIN more texels on each side, so that
the picture's border is lit and shadowed like its middle. Heights stay below HIGHEST texels, half a pixel of parallax at
the corner of the perspective picture.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import ClassVar

import bpy
import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from irpso_addon.blender.scenes.true_surface import TrueMaps, grid_quads, smooth_mesh, true_material
from irpso_addon.capture.camera import Camera
from irpso_addon.capture.types import Capture
from irpso_addon.geometry.build import domain_from_card
from irpso_addon.geometry.domain import Domain

from .resample import resampled
from .textured import linear_picture

SIDE, MARGIN = 128, 8
WIDTH = 2.0  # of the card that the picture shows, in world units
FIELD = 35.0  # degrees, of the perspective camera
DISTANCE = WIDTH / 2 / np.tan(np.radians(FIELD / 2))  # of that camera from the card
HIGHEST = 0.5 / (np.sqrt(2) * np.tan(np.radians(FIELD / 2)))  # texels
_FULL = SIDE + 2 * MARGIN
_QUADS = 512  # along a side of the mesh
_RIM = 1.03  # distance of a rim's inner wall, over half the picture's width
_BLUR = 1.0  # texels: standard deviation of the blur of borders between materials
_NARROW = 0.35  # roughness from which on 16 samples a pixel have an error of less than .2 % of its radiance


@dataclass(frozen=True)
class Card:
    """Maps of _FULL × _FULL texels, row 0 at the bottom. height: texels. base_color: (…, 3) linear."""

    height: np.ndarray
    base_color: np.ndarray
    roughness: np.ndarray
    metallic: np.ndarray
    side: ClassVar[int] = SIDE
    flat: ClassVar[bool] = True

    @property
    def digest(self) -> bytes:
        """Bytes that identify this card."""
        return b"".join(np.round(a, 6).astype(np.float32).tobytes() for a in vars(self).values())

    @property
    def fine(self) -> bool:
        """Whether the card has lobes so narrow that pixels need more samples."""
        return bool(self.roughness.min() < _NARROW)

    def build(self, maps: TrueMaps | None = None) -> None:
        """Put the card into the open scene; with recovered maps flat, one texel a pixel."""
        build_true(self) if maps is None else build_flat(maps)

    def truth(self, as_seen: TrueMaps) -> TrueMaps:
        """Return the true maps of the recovered texels, which are the pixels."""
        return as_seen

    def points(self, camera: Camera) -> np.ndarray:
        """Return (SIDE, SIDE, 3), the pixels' points on the flat card."""
        along = ((np.arange(SIDE) + 0.5) / SIDE - 0.5) * WIDTH
        x, y = np.meshgrid(along, along)
        return np.stack([x, y, np.zeros_like(x)], axis=-1)

    def arguments(self, folder: Path, shadows: bool) -> tuple[object, ...]:
        """Return the arguments of ``recover`` besides the capture: none."""
        return ()

    def domain(self, capture: Capture, shadows: bool) -> Domain:
        """Return the domain of a capture."""
        return domain_from_card(capture)


def card_table(data: Path) -> tuple[dict[str, Callable[[], Card]], dict[str, Callable[[], Card]]]:
    """Return name → card of the half for tuning and of the half for reports. data: folder with ``materials/``."""
    tune = {
        "polished_stone": partial(polished_stone, data / "materials" / "rock" / "albedo.jpg"),
        "gilding": gilding,
        "rust": rust,
        "varnished_wood": varnished_wood,
    }
    return tune, {"glazed_tiles": glazed_tiles, "brass_patina": brass_patina, "cloth": cloth, "skin": skin}


def polished_stone(albedo: Path) -> Card:
    """Return a polished slab with veins; its colours are those of a CC0 rock, or made here where that is missing."""
    noise = _Noise(1)
    if albedo.is_file():
        colour = np.pad(resampled(linear_picture(albedo), SIDE, SIDE), [(MARGIN, MARGIN)] * 2 + [(0, 0)], mode="wrap")
        colour = gaussian_filter(colour, (_BLUR, _BLUR, 0))
    else:
        colour = _mixed((0.22, 0.2, 0.17), (0.07, 0.06, 0.055), _step(noise(2.0) + noise(8.0), 1.0))
    vein = np.exp(-((noise(12.0) / 0.12) ** 2)) * _step(noise(16.0) + 0.5, 0.5)
    colour = _mixed(colour, (0.75, 0.7, 0.62), 0.9 * _soft(vein))
    roughness = 0.04 + 0.08 * _step(noise(9.0), 0.6)
    return _card(noise(5.0), 1.0, colour, roughness, 0.0)


def gilding() -> Card:
    """Return a painted ground of skin, red and blue with gold leaf on it, worn at its borders."""
    noise = _Noise(2)
    skin_or_red = _mixed((0.62, 0.34, 0.22), (0.42, 0.03, 0.025), _step(noise(14.0), 0.1))
    ground = _mixed(skin_or_red, (0.03, 0.07, 0.35), _step(noise(14.0) - 0.45, 0.1))
    ground = ground * (1 + 0.12 * noise(3.0))[..., None]
    field = noise(11.0) + 0.35 * noise(3.0)
    gold = gaussian_filter((field > 0.1).astype(float), 1.8)  # metallic goes from 1 to 0 over some four texels
    leaf = 0.9 * np.array((1.0, 0.77, 0.34)) * (1 + 0.05 * noise(4.0))[..., None]
    colour = _mixed(ground, leaf, gold)
    roughness = _mixed(0.5 + 0.1 * _even(noise(6.0)), 0.3 + 0.05 * _even(noise(6.0)), gold)
    relief = 0.35 * noise(3.5) + 0.9 * (gold - 0.5)
    return _card(relief, 1.0, colour, roughness, gold)


def rust() -> Card:
    """Return bare steel with islands of rust, whose borders are noisy."""
    noise = _Noise(3)
    field = noise(12.0) + 0.5 * noise(4.0) + 0.25 * noise(1.5)
    rusty = _soft((field > 0.0).astype(float))
    steel = np.array((0.56, 0.55, 0.53)) * (1 + 0.04 * noise(3.0))[..., None]
    red = _mixed((0.34, 0.11, 0.035), (0.12, 0.04, 0.02), _step(noise(3.0), 1.0))
    roughness = _mixed(0.3 + 0.03 * _even(noise(8.0)), 0.875 + 0.075 * _even(noise(4.0)), rusty)
    relief = 0.25 * noise(8.0) + rusty * (0.5 + 0.45 * noise(2.2))
    return _card(relief, 1.0, _mixed(steel, red, rusty), roughness, 1 - rusty)


def varnished_wood() -> Card:
    """Return a varnished board: bent year rings with pores, below a smooth film with slight waves."""
    noise = _Noise(4)
    x, y = _places()
    along = x + 0.08 * y + 5 * noise(20.0)
    rings = np.sin(2 * np.pi * along / 11) + 0.4 * noise((9.0, 1.2))
    late = _soft(_step(rings - 0.2, 0.7))
    colour = _mixed((0.46, 0.23, 0.09), (0.16, 0.06, 0.025), late) * (1 + 0.1 * noise((12.0, 1.5)))[..., None]
    roughness = 0.16 + 0.04 * _even(noise(8.0))
    return _card(0.25 * rings + 0.75 * noise(7.0), 0.9, colour, roughness, 0.0)


def glazed_tiles() -> Card:
    """Return glazed tiles of four colours, domed and bevelled, in a matt grout."""
    noise = _Noise(5)
    x, y = _places()
    pitch = SIDE / 4
    inward = np.minimum(*(np.abs((p + 10.0) % pitch - pitch / 2) * -1 + pitch / 2 for p in (x, y)))
    tile = _soft((inward > 2.0).astype(float))
    which = (np.floor((x + 10.0) / pitch) * 2 + np.floor((y + 10.0) / pitch) * 3).astype(int) % 4
    glazes = np.array([(0.03, 0.16, 0.36), (0.72, 0.68, 0.55), (0.06, 0.27, 0.12), (0.5, 0.2, 0.04)])
    glaze = glazes[which] * (1 + 0.1 * noise(6.0))[..., None]
    grout = np.array((0.42, 0.4, 0.37)) * (1 + 0.1 * noise(1.5))[..., None]
    bevel = _smooth(np.clip((inward - 2.0) / 6.0, 0, 1))
    roughness = _mixed(np.full_like(x, 0.9), 0.075 + 0.025 * _even(noise(9.0)), tile)
    relief = 1.25 * bevel + 0.2 * noise(6.0) * tile + 0.08 * noise(1.5) * (1 - tile)
    return _card(gaussian_filter(relief, 1.0), 1.0, _mixed(grout, glaze, tile), roughness, 0.0)


def brass_patina() -> Card:
    """Return brass, polished unevenly, with green patina."""
    noise = _Noise(6)
    green = _soft((noise(9.0) + 0.4 * noise(3.0) > 0.35).astype(float))
    brass = np.array((0.89, 0.72, 0.36)) * (1 + 0.03 * noise(4.0))[..., None]
    patina = _mixed((0.1, 0.36, 0.27), (0.26, 0.5, 0.4), _step(noise(3.0), 1.0))
    roughness = _mixed(0.325 + 0.125 * _even(noise(10.0)), 0.8 + 0.05 * _even(noise(4.0)), green)
    relief = 0.6 * noise(6.0) + green * (0.3 + 0.3 * noise(2.2))
    return _card(relief, 1.0, _mixed(brass, patina, green), roughness, 1 - green)


def cloth() -> Card:
    """Return a plain weave of two threads, matt."""
    noise = _Noise(7)
    x, y = (p + 0.6 * noise(12.0) for p in _places())
    pitch = 8.0
    above = np.sin(np.pi * x / pitch) * np.sin(np.pi * y / pitch)
    warp = _soft(_step(above, 0.15))
    colour = _mixed((0.55, 0.47, 0.33), (0.09, 0.12, 0.3), warp) * (1 + 0.08 * noise(1.5))[..., None]
    roughness = 0.95 + 0.05 * _even(noise(5.0))
    return _card(_soft(np.abs(above)) + 0.05 * noise(2.0), 0.85, colour, roughness, 0.0)


def skin() -> Card:
    """Return skin with pores, reddish and pale, oily and dry in places."""
    noise = _Noise(8)
    colour = _mixed((0.66, 0.4, 0.29), (0.5, 0.2, 0.13), _step(noise(10.0), 1.5))
    pores = _step(noise(2.2) - 1.0, 0.6)
    colour = colour * (1 + 0.06 * noise(2.0) - 0.25 * pores)[..., None]
    roughness = 0.45 + 0.1 * _even(noise(8.0))
    return _card(0.3 * noise(2.5) + 0.35 * noise(5.0) - 0.5 * pores, 1.0, colour, roughness, 0.0)


def build_true(card: Card) -> None:
    """Put the card into the open scene, as a mesh of _QUADS² quads with its material."""
    count = _QUADS + 1
    along = np.linspace(0, 1, count)
    v, u = np.meshgrid(along, along, indexing="ij")
    texels = [np.clip(a * _FULL - 0.5, 0, _FULL - 1) for a in (v, u)]
    height = map_coordinates(card.height, texels, order=3, mode="nearest")
    reach = WIDTH * _FULL / SIDE
    vertices = np.stack([(u - 0.5) * reach, (v - 0.5) * reach, height * WIDTH / SIDE], axis=-1)
    made = smooth_mesh(
        bpy.context.scene,
        "card",
        vertices.reshape(-1, 3),
        grid_quads(count, count),
        np.stack([u, v], axis=-1).reshape(-1, 2),
    )
    made.data.materials.append(
        true_material(TrueMaps(card.base_color, None, card.roughness, np.asarray(card.metallic)))
    )


def build_rim(height: float) -> None:
    """Put a matt grey rim of this height, which shadows the card, around the picture's area into the open scene.

    The reliefs are too low for shadows: with slopes five times as steep less than 1 % of the samples under 24 lamps
    would be in one.
    """
    inner, outer = WIDTH / 2 * _RIM, WIDTH / 2 * (1 + 2 * MARGIN / SIDE)
    low, high = -WIDTH * HIGHEST / SIDE, height
    made = bpy.data.materials.new("rim")
    made.use_nodes = True
    shader = made.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value, shader.inputs["Roughness"].default_value = (0.3, 0.3, 0.3, 1), 0.9
    for turn in np.array([(1, 0, 0, 1), (0, -1, 1, 0), (-1, 0, 0, -1), (0, 1, -1, 0)]).reshape(-1, 2, 2):
        flat = np.array([(inner, -outer), (outer, -outer), (outer, outer), (inner, outer)]) @ turn.T
        corners = np.concatenate([np.insert(flat, 2, z, axis=1) for z in (low, high)])
        sides = np.array([(4, 5, 6, 7), (0, 3, 2, 1), (0, 4, 7, 3), (1, 2, 6, 5), (0, 1, 5, 4), (3, 7, 6, 2)])
        wall = smooth_mesh(bpy.context.scene, "card", corners, sides, corners[:, :2])
        wall.data.shade_flat()
        wall.data.materials.append(made)


def build_flat(maps: TrueMaps) -> None:
    """Put a flat card with recovered maps, one texel a pixel, into the open scene."""
    reach = WIDTH / 2
    corners = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]) * reach
    made = smooth_mesh(bpy.context.scene, "card", corners, np.arange(4)[None], (corners[:, :2] / reach + 1) / 2)
    made.data.materials.append(true_material(maps, flat=True))


class _Noise:
    """Smooth noise of mean 0 and standard deviation 1; every call returns a new sample."""

    def __init__(self, seed: int):
        self._rng = np.random.default_rng(seed)

    def __call__(self, texels: float | tuple[float, float]) -> np.ndarray:
        """Return (_FULL, _FULL) white noise blurred by a Gaussian of ``texels``, or of two, along y and x."""
        values = gaussian_filter(self._rng.standard_normal((_FULL, _FULL)), texels, mode="wrap")
        return (values - values.mean()) / values.std()


def _card(relief: np.ndarray, share: float, colour: np.ndarray, roughness: np.ndarray, metallic) -> Card:
    """Return a card with the relief scaled to ``share`` of HIGHEST."""
    relief = relief - (relief.max() + relief.min()) / 2
    height = share * HIGHEST * relief / np.abs(relief).max()
    return Card(height, np.clip(colour, 0, 1), roughness, np.broadcast_to(metallic, height.shape).astype(np.float64))


def _places() -> tuple[np.ndarray, np.ndarray]:
    """Return x and y of the texels' centres, in texels from the lower left corner of the picture."""
    along = np.arange(_FULL) + 0.5 - MARGIN
    return tuple(np.meshgrid(along, along))


def _mixed(a, b, share: np.ndarray) -> np.ndarray:
    a, b = np.asarray(a, float), np.asarray(b, float)
    share = share[..., None] if max(a.ndim, b.ndim) != 2 else share
    return a + share * (b - a)


def _smooth(share: np.ndarray) -> np.ndarray:
    return share**2 * (3 - 2 * share)


def _step(values: np.ndarray, width: float) -> np.ndarray:
    """Return 0 below −width, 1 above width, and a smooth step between."""
    return _smooth(np.clip(values / (2 * width) + 0.5, 0, 1))


def _even(noise: np.ndarray) -> np.ndarray:
    """Return noise mapped to −1…1, roughly uniform."""
    return np.tanh(noise)


def _soft(mask: np.ndarray) -> np.ndarray:
    return gaussian_filter(mask, _BLUR)
