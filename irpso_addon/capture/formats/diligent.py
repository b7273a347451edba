"""Reads captures in the folder layout of DiLiGenT (Shi et al. 2016, a benchmark for photometric stereo)."""

from __future__ import annotations

from pathlib import Path

from ..errors import CaptureError
from ..images.image import ImageRef, find_image
from ..spec import CaptureSpec, ObservationSpec, ViewSpec
from .lists import read_directions, read_intensities, read_lines
from .toml_file import CAMERA_KEYS, camera_maker, has_lens, known_keys, load_toml

FILENAMES, DIRECTIONS, INTENSITIES = "filenames.txt", "light_directions.txt", "light_intensities.txt"
MASKS = ("mask.png", "mask.exr", "mask.tif", "mask.jpg")


def is_diligent(folder: Path) -> bool:
    """Return whether a folder holds one of the two lists of the layout."""
    return (folder / FILENAMES).is_file() or (folder / DIRECTIONS).is_file()


def spec_of_folder(folder: Path, colour_space: str = "auto") -> CaptureSpec:
    """Return the spec of a DiLiGenT folder.

    Without camera.toml the camera is orthographic; without a mask all pixels count. Raises CaptureError if a list is
    missing, damaged or of another length than the others.
    """
    names = read_lines(folder / FILENAMES, "write the images' names into it, one a line")
    lights = read_directions(folder / DIRECTIONS)
    _same_count(folder / DIRECTIONS, len(lights), len(names))
    path = folder / INTENSITIES
    intensities = read_intensities(path) if path.exists() else [(0, (1.0, 1.0, 1.0))] * len(names)
    _same_count(path, len(intensities), len(names))
    observations = []
    for (number, name), (line, vector), (row, intensity) in zip(names, lights, intensities, strict=True):
        # Errors name the intensity's line if the direction is valid.
        valid = any(vector) and all(abs(v) < float("inf") for v in vector)
        where = f"{path}: line {row}" if row and valid else f"{folder / DIRECTIONS}: line {line}"
        named_in = f"its name in {folder / FILENAMES}: line {number}"
        image = ImageRef(find_image(folder, name), colour_space=colour_space, named_in=named_in)
        observations.append(ObservationSpec(name, image, vector, where, intensity))
    mask = next((folder / m for m in MASKS if (folder / m).exists()), None)
    camera = folder / "camera.toml"
    table = load_toml(camera) if camera.exists() else {}
    known_keys(table, CAMERA_KEYS, str(camera))
    make, lens = camera_maker(table, str(camera)), has_lens(table)
    view = ViewSpec("camera", make, str(camera), None, ImageRef(mask) if mask else None, lens=lens)
    return CaptureSpec(folder.resolve().name, "DiLiGenT folder", folder, tuple(observations), (view,))


def _same_count(path: Path, count: int, expected: int) -> None:
    if count != expected:
        raise CaptureError(
            f"{path}: has {count} lights where {FILENAMES} has {expected} images; write one line for each image",
            "count",
        )
