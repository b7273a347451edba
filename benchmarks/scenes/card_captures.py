"""Cards photographed by Cycles as captures in the program's own format, and under lamps that the captures lack.

A folder of the cache holds ``capture/``, the truth as the camera sees it, and the pictures; what is there is not
rendered again.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import bpy
import numpy as np

from irpso_addon.capture.table import TABLE
from irpso_addon.capture.toml_text import toml_value
from irpso_addon.capture.types import Capture, Light, Observation
from irpso_addon.capture.write import write_capture
from irpso_addon.files import new_folder
from irpso_addon.geometry.scene import camera_from_object
from irpso_addon.maps.encode import srgb_from_linear

from . import cards, render
from .lights import dome_lights, lamp_places
from .sensor import Sensor
from .textured import TrueMaps, opaque

CAPTURE = "capture"
_UNSEEN_SAMPLES, _FLAT_SAMPLES = 64, 16  # a pixel of the flat card has one material, and next to no noise
UNSEEN = lamp_places(8, (20.0, 52.0), (2.6, 3.6), turn=225.0)  # 10° or more from every lamp of the captures
_OFF_AXIS, _FAR = (15.0, 60.0), (1.2 * cards.WIDTH, 2.0 * cards.WIDTH)
_CLIPPED = 0.015  # of the samples, in the brightest channel
_NOISE = {"read": 0.002, "shot": 0.01}  # shares of full scale
_QUALITY = 95
_NARROW = 0.35  # roughness; from there on 16 samples in a pixel are off by less than .2 % of its radiance


@dataclass(frozen=True)
class Shooting:
    """How a card is photographed. lights: (K, 3) directions or, where ``near``, places. bounces: of light paths.

    near: under lamps, by a perspective camera, as 8-bit sRGB JPEG with noise; else distant lights, an orthographic
    camera and EXR without noise. shadows: whether they are cast. samples: a pixel and light, of
    cards with narrow lobes and of others. rim: height of a rim around the picture, in world units.
    """

    lights: np.ndarray
    near: bool = True
    shadows: bool = False
    bounces: int = 0
    samples: tuple[int, int] = (32, 32)
    rim: float = 0.0


# What is left of the renderer's noise, on polished stone below radiance 1: root mean square .0015 with 16 samples,
# .0003 with 64, of full scale or less; the sensor's is .002 and more.
SHOOTINGS = {
    "lamps": Shooting(lamp_places(16, _OFF_AXIS, _FAR)),
    "distant": Shooting(dome_lights(48, 60.0), near=False, samples=(64, 16)),
    # With this rim 6.5 % of the samples are in shadow, up to 18 % of a picture; half of the texels never.
    "shadows": Shooting(lamp_places(24, _OFF_AXIS, _FAR), shadows=True, bounces=4, rim=0.3),
}


@dataclass(frozen=True)
class Photographed:
    """capture: its folder. truth: maps as render.truth gives them. unseen: (8, H, W, 3) radiance under UNSEEN."""

    capture: Path
    truth: dict[str, np.ndarray]
    unseen: np.ndarray


def photograph(name: str, card: cards.Card, shooting: Shooting, cache: Path) -> Photographed:
    """Return the card's capture, truth and unseen pictures, rendered where ``cache`` lacks them."""
    samples = shooting.samples[0 if card.roughness.min() < _NARROW else 1]
    lights = shooting.lights.tobytes(), UNSEEN.tobytes()
    how = shooting.near, shooting.shadows, shooting.bounces, samples, _UNSEEN_SAMPLES
    how += (shooting.rim,) if shooting.rim else ()
    key = repr((card.digest, lights, how, _CLIPPED, _NOISE, _QUALITY, cards.SIDE, cards.FIELD))
    folder = cache / f"{name}-{hashlib.sha256(key.encode()).hexdigest()[:10]}"
    _empty(shooting.near, samples, shooting.bounces)
    cards.build(card)
    if shooting.rim:
        cards.build_rim(shooting.rim)
    truth = render.truth(folder / "seen")
    if not (folder / CAPTURE).exists():
        _write(name, shooting, folder)
    _empty(shooting.near, _UNSEEN_SAMPLES, 0)
    cards.build(card)
    unseen = np.stack(list(render.photographs_near(folder / "unseen", UNSEEN, shadows=False)))
    return Photographed(folder / CAPTURE, truth, unseen)


def relight(maps: TrueMaps, near: bool, folder: Path) -> np.ndarray:
    """Return (8, H, W, 3) radiance of a flat card with these maps under UNSEEN, by the camera of ``near``."""
    _empty(near, _FLAT_SAMPLES, 0)
    cards.build_flat(maps)
    return np.stack(list(render.photographs_near(folder, UNSEEN, shadows=False)))


def diffuse_part(truth: dict[str, np.ndarray]) -> np.ndarray:
    """Return (8, H, W) mean over the channels of what the true diffuse base alone would radiate under UNSEEN.

    What the layer above takes from the base, some 4 %, is not taken off.
    """
    along = ((np.arange(cards.SIDE) + 0.5) / cards.SIDE - 0.5) * cards.WIDTH
    x, y = np.meshgrid(along, along)
    toward = UNSEEN[:, None, None] - np.stack([x, y, np.zeros_like(x)], axis=-1)
    squared = (toward**2).sum(axis=-1)
    cosine = (toward * truth["normal"]).sum(axis=-1) / np.sqrt(squared)
    albedo = (1 - truth["metallic"]) * truth["base_color"].mean(axis=-1)
    strength = (UNSEEN**2).sum(axis=-1)[:, None, None] / squared
    return albedo * np.maximum(cosine, 0) * strength


def _empty(near: bool, samples: int, bounces: int) -> None:
    view = render.View(cards.SIDE, cards.SIDE, cards.WIDTH, samples, bounces)
    render.empty_scene(view)
    camera = bpy.context.scene.camera
    if near:
        camera.data.type, camera.data.angle = "PERSP", np.radians(cards.FIELD)
        camera.location = (0, 0, cards.DISTANCE)
    bpy.context.view_layer.update()


def _write(name: str, shooting: Shooting, folder: Path) -> None:
    camera = camera_from_object(bpy.context.scene.camera, cards.SIDE, cards.SIDE)
    taken = render.photographs_near if shooting.near else render.photographs
    pictures = list(taken(folder / "seen", shooting.lights, shadows=shooting.shadows))
    if not shooting.near:
        shots = tuple(
            Observation(f"light {n}", partial(opaque, image), Light(tuple(map(float, direction))))
            for n, (image, direction) in enumerate(zip(pictures, shooting.lights, strict=True))
        )
        mask = np.ones((cards.SIDE, cards.SIDE), bool)
        write_capture(Capture(name, shots, (camera,), (mask,)), folder / CAPTURE)
        return
    brightest = np.stack(pictures).max(axis=-1)
    sensor = Sensor(gain=float(1 / np.quantile(brightest, 1 - _CLIPPED)), **_NOISE)
    with new_folder(folder / CAPTURE) as partly:
        for number, picture in enumerate(pictures):
            write_jpeg(partly / f"{number:03d}.jpg", srgb_from_linear(sensor.expose(picture, number)))
        (partly / TABLE).write_text("\n".join(_table(name, shooting.lights, sensor.gain)) + "\n", encoding="utf-8")


def _table(name: str, places: np.ndarray, gain: float) -> Iterator[str]:
    """Yield the lines of a capture table: a camera above the middle of the card, and lamps as bright as rendered."""
    matrix = np.eye(4)
    matrix[2, 3] = cards.DISTANCE
    yield from ("format = 1", f"name = {toml_value(name)}", 'colour_space = "srgb"')
    yield f"card_distance = {toml_value(float(cards.DISTANCE))}"
    yield from ("", "[[camera]]", f"width = {cards.SIDE}", f"height = {cards.SIDE}", f"fov_degrees = {cards.FIELD}")
    yield f"matrix = {toml_value(matrix.ravel())}"
    for number, place in enumerate(places):
        yield from ("", "[[observation]]", f'image = "{number:03d}.jpg"', f"light_position = {toml_value(place)}")
        yield f"light_intensity = {toml_value(float(gain * place @ place))}"


def write_jpeg(path: Path, codes: np.ndarray, quality: int = _QUALITY) -> None:
    """Write (H, W, 3) sRGB values in 0…1, row 0 at the bottom, by Blender, whose loader reads them again."""
    image = bpy.data.images.new(path.stem, codes.shape[1], codes.shape[0])
    try:
        image.pixels.foreach_set(opaque(codes.astype(np.float32)).ravel())
        image.filepath_raw, image.file_format = str(path), "JPEG"
        image.save(quality=quality)
    finally:
        bpy.data.images.remove(image)
