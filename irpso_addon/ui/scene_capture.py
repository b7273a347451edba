"""The capture that a scene's settings name: from files, or the scene itself."""

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path

from ..capture.draft import build_steps
from ..capture.read import read_draft
from ..capture.steps import run_steps
from ..capture.types import Capture
from ..errors import InputError
from ..geometry.scene_capture import scene_steps
from ..maps.blender_images import decode
from .file_paths import absolute


def capture_of(scene) -> Capture:
    """Return the capture that a scene's settings name; images are read when they are asked for. Raises InputError."""
    return run_steps(capture_steps(scene))


def capture_steps(scene) -> Generator[None, None, Capture]:
    """Yield before each image's header is looked at, and return what ``capture_of`` does."""
    settings = scene.irpso
    if settings.source == "SCENE":
        return (yield from scene_steps(scene))  # whose images say themselves how they are encoded
    draft = read_draft(capture_path(settings), settings.colour_space)
    return (yield from build_steps(draft, decode))


def capture_path(settings) -> Path:
    """Return the path of the capture's files. Raises InputError where none is chosen."""
    if not settings.capture_path:
        raise InputError("Capture: none is chosen; import a folder, an .lp list or a capture.toml")
    return absolute(settings.capture_path, "Capture")


def capture_from_scene(scene) -> Capture:
    """Return the capture that a scene itself is, with its own settings: see ``geometry.scene_capture``."""
    return run_steps(scene_steps(scene))
