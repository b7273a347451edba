"""Reads captures in the folder layout of DiLiGenT (Shi et al. 2016, a benchmark for photometric stereo)."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from ...core.files import visible
from ..errors import CaptureError
from ..images.image import SUFFIXES, ImageRef, find_image
from ..spec import CaptureKind, CaptureSpec, ObservationSpec, ViewSpec
from .lists import read_directions, read_intensities, read_lines
from .toml_file import CAMERA_KEYS, camera_maker, has_lens, known_keys, load_toml

FILENAMES, DIRECTIONS, INTENSITIES = "filenames.txt", "light_directions.txt", "light_intensities.txt"
_MASK = "mask"


def is_diligent(folder: Path) -> bool:
    """Return whether a folder holds one of the two lists of the layout."""
    return (folder / FILENAMES).is_file() or (folder / DIRECTIONS).is_file()


def is_mask(path: Path) -> bool:
    """Return whether a file has a mask's name, in any letter case, and the suffix of a picture."""
    return path.stem.lower() == _MASK and path.suffix.lower() in SUFFIXES


def mask_of(folder: Path, hidden: Collection[Path] = ()) -> Path | None:
    """Return the mask in a folder; of several the first by suffix. hidden: resolved paths of files to ignore."""
    masks = [p for p in visible(folder) if is_mask(p) and p.is_file() and p.resolve() not in hidden]
    return min(masks, key=lambda path: SUFFIXES.index(path.suffix.lower()), default=None)


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
    mask = mask_of(folder)
    camera = folder / "camera.toml"
    table = load_toml(camera) if camera.exists() else {}
    known_keys(table, CAMERA_KEYS, str(camera))
    make, lens = camera_maker(table, str(camera)), has_lens(table)
    view = ViewSpec("camera", make, str(camera), None, ImageRef(mask) if mask else None, lens=lens)
    return CaptureSpec(folder.resolve().name, CaptureKind.DILIGENT, folder, tuple(observations), (view,))


def _same_count(path: Path, count: int, expected: int) -> None:
    if count != expected:
        raise CaptureError(
            f"{path}: has {count} lights where {FILENAMES} has {expected} images; write one line for each image",
            "count",
        )
