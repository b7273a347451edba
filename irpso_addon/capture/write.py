"""Writes a capture as a folder: capture.toml and EXR images."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..core.files import new_folder
from ..core.steps import blocking
from ..core.toml_text import toml_value
from .bounds import without_bounds
from .camera import Camera
from .errors import CaptureError
from .formats.table import CARD_DISTANCE, FORMAT, TABLE
from .framing import Framing
from .images.exr import write_exr
from .images.exr_header import Turn
from .types import Capture, Light

_IMAGES = "images.exr"
_WHOLE = Framing()


def write_steps(
    capture: Capture,
    folder: Path | str,
    *,
    half: bool = False,
    single_file: bool = False,
    framing: Framing = _WHOLE,
    turns: Sequence[Turn | None] = (),
) -> Generator[float, None, list[str]]:
    """Write a capture into a new or empty folder, whole or not at all; yield the fraction done before each image.

    ``read_capture`` reads it back. half: 16-bit instead of 32-bit floats (values from 65504 read back as clipped).
    single_file: all images and masks as parts of one EXR; the cameras must have one size. framing: of the images, for
    whoever reads the folder. turns: of the photographs, for single files. Weights other than 1 are kept as alpha.
    Returns the names of files or parts. Raises InputError if the folder is not empty or cannot be written, or sizes
    differ.
    """
    folder = Path(folder)
    if single_file and len({(camera.width, camera.height) for camera in capture.cameras}) > 1:
        raise CaptureError(f"{folder}: cameras differ in size, which one EXR cannot hold; write single files", "size")
    count = max(3, len(str(len(capture.observations))))
    names = [f"{n:0{count}d}" for n in range(len(capture.observations))]
    masked = np.flatnonzero([not mask.all() for mask in capture.masks]).tolist()
    with new_folder(folder) as partial:
        parts: dict[str, dict[str, np.ndarray]] = {}
        for n, (name, observation) in enumerate(zip(names, capture.observations, strict=True)):
            yield n / len(names)
            channels = _channels(observation.read())
            if single_file:
                parts[name] = channels
            else:
                write_exr(partial / f"{name}.exr", {"": channels}, half, turns[n] if turns else None)
        masks = {n: {"Y": capture.masks[n].astype(np.float32)} for n in masked}
        if single_file:
            write_exr(partial / _IMAGES, parts | {f"mask_{n}": mask for n, mask in masks.items()}, half)
            pictures = [{"part": name} for name in names]
            mask_keys = {n: {"mask": _IMAGES, "mask_part": f"mask_{n}"} for n in masked}
        else:
            for n, mask in masks.items():
                write_exr(partial / f"mask_{n}.exr", {"": mask}, half=True)
            pictures = [{"image": f"{name}.exr"} for name in names]
            mask_keys = {n: {"mask": f"mask_{n}.exr"} for n in masked}
        top = {"colour_space": "linear", **({"image": _IMAGES} if single_file else {}), **framing.keys()}
        (partial / TABLE).write_text(table_text(capture, pictures, mask_keys, top), encoding="utf-8")
    return names if single_file else [f"{name}.exr" for name in names]


write_capture = blocking("write_capture", write_steps)


def _channels(rgba: np.ndarray) -> dict[str, np.ndarray]:
    rgba = without_bounds(rgba)
    channels = {name: rgba[..., i] for i, name in enumerate("RGB")}
    return channels if (rgba[..., 3] == 1).all() else {**channels, "A": rgba[..., 3]}


def table_text(
    capture: Capture,
    pictures: Sequence[Mapping[str, Any]],
    masks: Mapping[int, Mapping[str, Any]],
    top: Mapping[str, Any],
) -> str:
    """Return the text of the capture.toml of a capture's cameras and lights.

    pictures: keys of each observation's image. masks: camera → keys of its mask. top: other top-level keys.
    """
    return "\n".join(_lines(capture, pictures, masks, top)) + "\n"


def _lines(
    capture: Capture,
    pictures: Sequence[Mapping[str, Any]],
    masks: Mapping[int, Mapping[str, Any]],
    top: Mapping[str, Any],
) -> Iterator[str]:
    yield f"format = {FORMAT}"
    yield f"name = {toml_value(capture.name)}"
    yield from _keys(top)
    if capture.card_distance is not None:
        yield f"{CARD_DISTANCE} = {_numbers(capture.card_distance)}"
    for n, camera in enumerate(capture.cameras):
        yield from ["", "[[camera]]", f'name = "camera {n + 1}"', *_camera(camera), *_keys(masks.get(n, {}))]
    for picture, observation in zip(pictures, capture.observations, strict=True):
        light = observation.light
        yield from ["", "[[observation]]", f"name = {toml_value(observation.name)}", *_keys(picture)]
        yield f"light_{'direction' if light.distant else 'position'} = {_numbers(light.vector)}"
        yield f"light_intensity = {_numbers(light.intensity)}"
        yield from _emission(light)
        yield f'camera = "camera {observation.camera + 1}"'


def _keys(table: Mapping[str, Any]) -> Iterator[str]:
    yield from (f"{key} = {toml_value(value)}" for key, value in table.items())


def _emission(light: Light) -> Iterator[str]:
    if light.axis is not None:
        yield f"light_axis = {_numbers(light.axis)}"
    if light.cone is not None:
        yield f"light_cone_degrees = {_numbers(light.cone)}"
    if light.cosine:
        yield f"light_cosine = {'true' if light.cosine == 1 else _numbers(light.cosine)}"


def _camera(camera: Camera) -> Iterator[str]:
    yield f"width = {camera.width}"
    yield f"height = {camera.height}"
    yield "matrix = ["
    yield from (f"    {', '.join(_numbers(v) for v in row)}," for row in camera.matrix)
    yield "]"
    if camera.perspective:
        yield f"focal_length_px = {_numbers(camera.scale)}"
    else:
        yield "orthographic = true"
        yield f"world_width = {_numbers(camera.width / camera.scale[0])}"
        if camera.scale[0] != camera.scale[1]:
            yield f"world_height = {_numbers(camera.height / camera.scale[1])}"
    yield f"principal_point = {_numbers(camera.centre)}"
    if camera.distortion:
        yield f"distortion = {_numbers(camera.distortion)}"


def _numbers(values: ArrayLike) -> str:
    return toml_value(np.asarray(values, np.float64))
