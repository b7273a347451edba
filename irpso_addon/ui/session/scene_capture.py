"""The capture of a scene's settings: from files, or from the scene itself."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...blender.images import decode
from ...blender.scenes.scene_capture import photographed_lights, scene_steps
from ...capture.frame.find import DetectedCorners
from ...capture.framing import Framing, framed_steps
from ...capture.images.image import ImageStore
from ...capture.inspect.damage import with_skip_remedy, without_damaged_steps
from ...capture.read import read_spec
from ...capture.spec import CaptureSpec, build_steps, reframed
from ...capture.types import Capture
from ...core.errors import InputError
from ...core.steps import map_steps, run_steps
from ..common.file_paths import absolute
from ..common.numbers import typed


def has_capture(settings) -> bool:
    """Return whether a capture is chosen: the open scene, or files."""
    return settings.source == "SCENE" or settings.capture_path != ""


def capture_of(scene) -> Capture:
    """Return the capture of a scene's settings; images are read at first use. Raises InputError."""
    return run_steps(capture_steps(scene))


def capture_steps(scene) -> Generator[None, None, Capture]:
    """Yield before each image header is read; return the capture as ``capture_of``."""
    settings = scene.irpso
    with with_skip_remedy(settings.skip_damaged):
        if settings.source == "SCENE":
            return (yield from _scene_steps(scene))
        spec = yield from spec_steps(settings)
        capture = yield from build_steps(spec, decode)
        return (yield from map_steps(framed_steps(capture, spec.framing), lambda _: None))


def spec_steps(settings) -> Generator[None, None, CaptureSpec]:
    """Yield before each decoded image; return ``spec_of``, without damaged images if the settings leave them out."""
    spec = spec_of(settings)
    return (yield from without_damaged_steps(spec, ImageStore(decode))) if settings.skip_damaged else spec


def spec_of(settings) -> CaptureSpec:
    """Return the spec of the capture's files, with the settings' framing and card distance. Raises InputError.

    Also stores in the settings the values that panels show, because panels read no files.
    """
    spec = read_spec(capture_path(settings), settings.colour_space)
    store_light_facts(settings, spec)
    return with_card(settings, spec)


def with_card(settings, spec: CaptureSpec) -> CaptureSpec:
    """Return the spec of files with the settings' framing and card distance. Raises InputError."""
    framing = _framing_of(settings, spec.framing)
    given = settings.card_width or settings.card_distance
    spec = replace(spec, framing=framing) if given else reframed(spec, framing, ImageStore(decode))
    # Blender stores 420.1 as 420.1000061: an unchanged field keeps the file's own digits.
    if settings.card_distance in (0.0, np.float32(spec.card_distance or 0.0)):
        return spec
    return replace(spec, card_distance=typed(settings.card_distance), framing=replace(spec.framing, card_width=None))


def _framing_of(settings, stated: Framing) -> Framing:
    """Return the capture's own framing with the changes of the settings. Raises InputError."""
    changes: dict[str, Any] = {}
    if settings.subject == "CARD" and settings.framing == "CROP":
        changes = {"crop": tuple(settings.crop), "corners": None}
    elif settings.subject == "CARD" and settings.framing == "CORNERS":
        numbers = [typed(value) for value in settings.corners]
        changes = {"crop": None, "corners": tuple(zip(numbers[::2], numbers[1::2], strict=True))}
    if settings.subject == "CARD" and settings.card_width > 0:
        changes["card_width"] = typed(settings.card_width)
    if settings.picture_scale < 1:
        changes["scale"] = typed(settings.picture_scale)
    return replace(stated, **changes)


def is_marked(settings) -> bool:
    """Return whether the card is marked in the photographs, or needs no marks."""
    marks = {"CROP": settings.crop, "CORNERS": settings.corners}.get(settings.framing)
    return marks is None or any(marks)


def keep_corners(settings, detected: DetectedCorners) -> None:
    """Make detected corners the frame, and a marker board's width the card's if near lights need a distance."""
    settings.framing, settings.corners = "CORNERS", np.ravel(detected.corners).tolist()
    settings.crop = crop_around(np.array(detected.corners))
    if detected.width and settings.near_lights and not knows_distance(settings):
        settings.card_width = detected.width


def crop_around(corners: np.ndarray) -> list[int]:
    """Return x, y, width and height in whole pixels of the crop that holds corners (4, 2)."""
    low, high = np.floor(corners.min(axis=0)), np.ceil(corners.max(axis=0))
    return [int(value) for value in (*low, *(high - low))]


def store_light_facts(settings, spec: CaptureSpec) -> None:
    """Store whether lights of the files have positions, and the files' card distance."""
    settings.near_lights = not all(observation.distant for observation in spec.observations)
    settings.stated_distance, settings.stated_width = spec.card_distance or 0.0, spec.framing.card_width or 0.0


def wants_distance(scene) -> bool:
    """Return whether the maps depend on the distance from card to camera: only with near lights."""
    settings = scene.irpso
    if settings.subject != "CARD":
        return False
    if settings.source == "FILES":
        return settings.near_lights
    return any(obj.data.type != "SUN" for obj in photographed_lights(scene))


def knows_distance(settings) -> bool:
    """Return whether the distance of a card, or its width, is set or stated in the files."""
    stated = settings.source == "FILES" and (settings.stated_distance or settings.stated_width or settings.card_width)
    return bool(settings.card_distance or stated)


def _scene_steps(scene) -> Generator[None, None, Capture]:
    # Blender's images state their own encoding.
    capture = yield from scene_steps(scene, skip_damaged=scene.irpso.skip_damaged)
    return replace(capture, card_distance=typed(scene.irpso.card_distance) or None)


def capture_path(settings) -> Path:
    """Return the path of the capture's files. Raises InputError if none is chosen."""
    if not settings.capture_path:
        raise InputError("Capture: none is chosen; import a folder, an .lp list or a capture.toml")
    return absolute(settings.capture_path, "Capture")


def capture_from_scene(scene) -> Capture:
    """Return the capture of a scene's own cameras and lights: see ``blender.scenes.scene_capture``."""
    return run_steps(_scene_steps(scene))
