"""Captures of cards and the head by Cycles, in the program's format, and pictures under other lamps.

A folder of the cache holds ``capture/``, the truth as the camera sees it, and the pictures, which are rendered once.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import bpy
import numpy as np

from irpso_addon.blender.scenes.scene import camera_from_object
from irpso_addon.blender.scenes.true_surface import TrueMaps
from irpso_addon.capture.camera import Camera
from irpso_addon.capture.formats.table import TABLE
from irpso_addon.capture.images.exr import write_exr
from irpso_addon.capture.types import Capture
from irpso_addon.capture.write import write_capture
from irpso_addon.core.encode import srgb_from_linear
from irpso_addon.core.files import new_folder
from irpso_addon.core.toml_text import toml_value
from irpso_addon.geometry.domain import Domain
from irpso_addon.sample.sensor import Sensor

from . import cards, render
from .lights import dome_lights, lamp_places
from .textured import opaque, shots

CAPTURE = "capture"
_MASK = "mask.exr"
_UNSEEN_SAMPLES, _RELIT_SAMPLES = 64, 16  # a pixel of the flat card has one material, and next to no noise
UNSEEN = lamp_places(8, (20.0, 52.0), (2.6, 3.6), turn=225.0)  # 10° or more from every lamp of the captures
_OFF_AXIS, _FAR = (15.0, 60.0), (1.2 * cards.WIDTH, 2.0 * cards.WIDTH)
_CLIPPED = 0.015  # of the samples, in the brightest channel
_NOISE = {"read": 0.002, "shot": 0.01}  # shares of full scale
_QUALITY = 95


class Subject(Protocol):
    """A subject within cards.WIDTH around the origin that faces +z: a card (cards.py) or a head (head.py).

    side: pixels along a side of its pictures. digest: identifies it. flat: a card, whose texels are the pixels. fine:
    needs the larger number of samples. build: puts it into the open scene, with its true maps or recovered ones; the
    other methods need that scene. truth: the texels' maps from the pixels'. arguments: of recover.
    """

    side: int
    flat: bool

    @property
    def digest(self) -> bytes: ...
    @property
    def fine(self) -> bool: ...
    def build(self, maps: TrueMaps | None = None) -> None: ...
    def truth(self, as_seen: TrueMaps) -> TrueMaps: ...
    def points(self, camera: Camera) -> np.ndarray: ...
    def arguments(self, folder: Path, shadows: bool) -> tuple[object, ...]: ...
    def domain(self, capture: Capture, shadows: bool) -> Domain: ...


@dataclass(frozen=True)
class Shooting:
    """How a subject is photographed. lights: (K, 3) directions, or positions if ``near``. bounces: of light paths.

    near: under lamps, by a perspective camera, as 8-bit sRGB JPEG with noise; else distant lights, an orthographic
    camera and EXR without noise. shadows: whether they are cast. samples: a pixel and light, of fine subjects and of
    others. rim: height of a rim around the picture of a card, in world units.
    """

    lights: np.ndarray
    near: bool = True
    shadows: bool = False
    bounces: int = 0
    samples: tuple[int, int] = (32, 32)
    rim: float = 0.0


# Noise of the renderer on polished stone below radiance 1: root mean square .0015 with 16 samples, .0003 with 64, of
# full scale or less; the sensor's is .002 and more.
SHOOTINGS = {
    "lamps": Shooting(lamp_places(16, _OFF_AXIS, _FAR)),
    "distant": Shooting(dome_lights(48, 60.0), near=False, samples=(64, 16)),
    # With this rim 6.5 % of the samples are in shadow, up to 18 % of a picture; half of the texels never.
    "shadows": Shooting(lamp_places(24, _OFF_AXIS, _FAR), shadows=True, bounces=4, rim=0.3),
}


@dataclass(frozen=True)
class Photographed:
    """A photographed subject. capture: folder. arguments: further ones of ``recover``. truth: of the recovered texels.

    as_seen: the truth as the camera sees it, normals in its axes. points: (H, W, 3), surface points of the pixels.
    shown: (H, W) bool, pixels of the subject alone. unseen: (8, H, W, 3) radiance under UNSEEN.
    """

    capture: Path
    arguments: tuple[object, ...]
    truth: TrueMaps
    as_seen: TrueMaps
    points: np.ndarray
    shown: np.ndarray
    unseen: np.ndarray


def photograph(name: str, subject: Subject, shooting: Shooting, cache: Path) -> Photographed:
    """Return the subject's capture, truth and unseen pictures; render what ``cache`` lacks."""
    samples = shooting.samples[0 if subject.fine else 1]
    lights = shooting.lights.tobytes(), UNSEEN.tobytes()
    how = shooting.near, shooting.shadows, shooting.bounces, samples, _UNSEEN_SAMPLES
    how += (shooting.rim,) if shooting.rim else ()
    key = repr((subject.digest, lights, how, _CLIPPED, _NOISE, _QUALITY, subject.side, cards.FIELD))
    folder = cache / f"{name}-{hashlib.sha256(key.encode()).hexdigest()[:10]}"
    _empty(subject, shooting.near, samples, shooting.bounces)
    subject.build()
    if shooting.rim and subject.flat:
        cards.build_rim(shooting.rim)
    seen = render.truth(folder / "seen")
    as_seen, shown = _maps(seen), seen["coverage"] > 0.999
    if not (folder / CAPTURE).exists():
        _write(name, subject, shooting, shown, folder)
    _empty(subject, shooting.near, _UNSEEN_SAMPLES, 0)
    subject.build()
    unseen = np.stack(list(render.photographs_near(folder / "unseen", UNSEEN, shadows=False)))
    points = subject.points(_camera(subject))
    arguments = subject.arguments(folder, shooting.shadows)
    return Photographed(folder / CAPTURE, arguments, subject.truth(as_seen), as_seen, points, shown, unseen)


def relight(subject: Subject, maps: TrueMaps, near: bool, folder: Path) -> tuple[np.ndarray, TrueMaps]:
    """Return (8, H, W, 3) radiance of a subject with recovered maps under UNSEEN, and the maps as the camera sees them.

    The camera is that of ``near``.
    """
    _empty(subject, near, _RELIT_SAMPLES, 0)
    subject.build(maps)
    as_seen = _maps(render.truth(folder))
    return np.stack(list(render.photographs_near(folder, UNSEEN, shadows=False))), as_seen


def diffuse_part(shot: Photographed) -> np.ndarray:
    """Return (8, H, W): radiance of the true diffuse base alone under UNSEEN, mean over the channels.

    Without the loss in the layer above it, some 4 %.
    """
    toward = UNSEEN[:, None, None] - shot.points
    squared = (toward**2).sum(axis=-1)
    cosine = (toward * shot.as_seen.normal).sum(axis=-1) / np.sqrt(squared)
    albedo = (1 - shot.as_seen.metallic) * shot.as_seen.base_color.mean(axis=-1)
    strength = (UNSEEN**2).sum(axis=-1)[:, None, None] / squared
    return albedo * np.maximum(cosine, 0) * strength


def _maps(truth: dict[str, np.ndarray]) -> TrueMaps:
    return TrueMaps(*(truth[name] for name in ("base_color", "normal", "roughness", "metallic")))


def _empty(subject: Subject, near: bool, samples: int, bounces: int) -> None:
    view = render.View(subject.side, subject.side, cards.WIDTH, samples, bounces)
    render.empty_scene(view)
    camera = bpy.context.scene.camera
    if near:
        camera.data.type, camera.data.angle = "PERSP", np.radians(cards.FIELD)
        camera.location = (0, 0, cards.DISTANCE)
    bpy.context.view_layer.update()


def _camera(subject: Subject) -> Camera:
    return camera_from_object(bpy.context.scene.camera, subject.side, subject.side)


def _write(name: str, subject: Subject, shooting: Shooting, shown: np.ndarray, folder: Path) -> None:
    taken = render.photographs_near if shooting.near else render.photographs
    pictures = list(taken(folder / "seen", shooting.lights, shadows=shooting.shadows))
    if not shooting.near:
        write_capture(Capture(name, shots(pictures, shooting.lights), (_camera(subject),), (shown,)), folder / CAPTURE)
        return
    brightest = np.stack(pictures).max(axis=-1)[:, shown]
    sensor = Sensor(gain=float(1 / np.quantile(brightest, 1 - _CLIPPED)), **_NOISE)
    with new_folder(folder / CAPTURE) as partly:
        for number, picture in enumerate(pictures):
            write_jpeg(partly / f"{number:03d}.jpg", srgb_from_linear(sensor.expose(picture, number)))
        if not subject.flat:
            write_exr(partly / _MASK, {"": {"Y": shown.astype(np.float32)}}, half=True)
        lines = _table(name, subject, shooting.lights, sensor.gain)
        (partly / TABLE).write_text("\n".join(lines) + "\n", encoding="utf-8")


def _table(name: str, subject: Subject, places: np.ndarray, gain: float) -> Iterator[str]:
    """Yield the lines of a capture table: a camera above the subject's centre, and lamps as bright as rendered."""
    matrix = np.eye(4)
    matrix[2, 3] = cards.DISTANCE
    yield from ("format = 1", f"name = {toml_value(name)}", 'colour_space = "srgb"')
    if subject.flat:
        yield f"card_distance = {toml_value(float(cards.DISTANCE))}"
    yield from ("", "[[camera]]", f"width = {subject.side}", f"height = {subject.side}")
    yield from (f"fov_degrees = {cards.FIELD}", f"matrix = {toml_value(matrix.ravel())}")
    if not subject.flat:
        yield f'mask = "{_MASK}"'
    for number, place in enumerate(places):
        yield from ("", "[[observation]]", f'image = "{number:03d}.jpg"', f"light_position = {toml_value(place)}")
        yield f"light_intensity = {toml_value(float(gain * place @ place))}"


def write_jpeg(path: Path, codes: np.ndarray, quality: int = _QUALITY) -> None:
    """Write (H, W, 3) sRGB values in 0…1, row 0 at the bottom, by Blender."""
    image = bpy.data.images.new(path.stem, codes.shape[1], codes.shape[0])
    try:
        image.pixels.foreach_set(opaque(codes.astype(np.float32)).ravel())
        image.filepath_raw, image.file_format = str(path), "JPEG"
        image.save(quality=quality)
    finally:
        bpy.data.images.remove(image)
