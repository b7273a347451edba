"""Reads and writes OpenEXR files: parts, layers, half and float, windows. Row 0 is the bottom."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...core.encode import linear_from_srgb
from ...core.files import replacing_file
from ..errors import CaptureError
from .exr_header import TURN_NAMES, ExrPart, Turn, read_exr_header
from .linearise import Samples, samples
from .primaries import BY_NAME, UNKNOWN_SPACES, to_rec_709

if TYPE_CHECKING:
    from OpenEXR import Part

_HALF_MAX = 65504.0


@dataclass(frozen=True)
class ExrImage:
    """One part of an EXR file. channels: name → (H, W) over the display window. inside: (H, W) bool, the data window.

    Pixels outside the data window are 0; overscan outside the display window is dropped.
    """

    channels: dict[str, np.ndarray]
    inside: np.ndarray


def read_exr(path: Path | str) -> dict[str, dict[str, np.ndarray]]:
    """Return part name → channel name → (H, W) float16, float32 or uint32, row 0 at the bottom.

    An unnamed single part is called "". Raises CaptureError where the file is missing, damaged or subsampled.
    """
    return {name: image.channels for name, image in load_exr(Path(path)).items()}


def load_exr(path: Path) -> dict[str, ExrImage]:
    """Return part name → ExrImage, in the file's order; see read_exr."""
    import OpenEXR

    headers = read_exr_header(path)
    if any(part.subsampled for part in headers):
        raise CaptureError(f"{path}: has chroma of lower resolution (Y, RY, BY); save it as RGB", "image_unknown")
    try:
        # OpenEXR's Python layer prints warnings; missing parts and channels are detected below.
        with contextlib.redirect_stdout(io.StringIO()), OpenEXR.File(str(path), separate_channels=True) as file:
            images = {h.name: _image(part) for h, part in zip(headers, file.parts, strict=True)}
    except (RuntimeError, ValueError, TypeError, MemoryError) as error:
        raise CaptureError(
            f"{path}: cannot be decoded as OpenEXR ({error}); export it again", "image_truncated"
        ) from error
    if any(set(h.channels) != set(images[h.name].channels) for h in headers):
        raise CaptureError(f"{path}: some of its channels cannot be decoded; export it again", "image_truncated")
    return images


def _image(part: Part) -> ExrImage:
    (x0, y0), (x1, y1) = (np.asarray(corner, int) for corner in part.header["displayWindow"])
    (left, top), (right, bottom) = (np.asarray(corner, int) for corner in part.header["dataWindow"])
    inside = np.zeros((y1 - y0 + 1, x1 - x0 + 1), bool)
    # The intersection of both windows, in the file's coordinates; empty, never negative.
    a, b = max(x0, left), max(y0, top)
    c, d = max(min(x1, right) + 1, a), max(min(y1, bottom) + 1, b)
    target = slice(b - y0, d - y0), slice(a - x0, c - x0)
    source = slice(b - top, d - top), slice(a - left, c - left)
    inside[target] = True
    channels = {}
    for name, channel in part.channels.items():
        full = np.zeros(inside.shape, channel.pixels.dtype)
        full[target] = channel.pixels[source]
        channels[name] = full[::-1]
    return ExrImage(channels, inside[::-1])


def colour_channels(part: ExrPart, layer: str | None, where: str) -> tuple[list[str], str | None]:
    """Return the names of the red, green and blue channels, and of alpha or None.

    layer: the text before the last dot, as in "diffuse.R"; None takes the unnamed layer, or the only one there is.
    One channel (Y, or any lone one) serves as all three. Raises CaptureError naming the layers there are.
    """
    layers: dict[str, dict[str, str]] = {}
    for name in part.channels:
        prefix, _, last = name.rpartition(".")
        layers.setdefault(prefix, {})[last.upper()] = name
    colours = {prefix: found for prefix, table in layers.items() if (found := _rgb(table))}
    if layer is None and "" not in colours and len(colours) == 1:
        layer = next(iter(colours))
    chosen = colours.get(layer or "")
    if chosen is None:
        if not colours:
            raise CaptureError(f"{where}: has no channels R, G, B or Y; export it as RGB", "layer")
        names = ", ".join(repr(name) for name in sorted(colours) if name) or "none with a name"
        what = "has several image layers" if layer is None else f"has no image layer '{layer}'"
        raise CaptureError(f"{where}: {what}; set layer in a capture.toml to one it has ({names})", "layer")
    return chosen, layers[layer or ""].get("A")


def _rgb(table: dict[str, str]) -> list[str] | None:
    if all(c in table for c in "RGB"):
        return [table[c] for c in "RGB"]
    if "Y" in table:
        return [table["Y"]] * 3
    colours = [name for last, name in table.items() if last != "A"]
    return colours * 3 if len(colours) == 1 else None


def matrix_to_rec_709(part: ExrPart, rgb: Collection[str], where: str) -> np.ndarray | None:
    """Return the matrix (3, 3) from a part's primaries to linear Rec. 709; None for equal ones or one channel.

    Raises CaptureError, naming ``where``, if the part states a colour space that is unknown.
    """
    chromaticities = part.chromaticities or BY_NAME.get(part.colour_space)
    if len(set(rgb)) == 1:
        return None
    if chromaticities is None:
        if part.colour_space in UNKNOWN_SPACES:
            return None
        raise CaptureError(
            f"{where}: is in the colour space '{part.colour_space}'; export it as linear Rec. 709", "image_unknown"
        )
    try:
        return to_rec_709(chromaticities)
    except ValueError as error:
        raise CaptureError(
            f"{where}: its chromaticities define no colour space; export it as linear Rec. 709", "image_unknown"
        ) from error


def samples_of_exr(
    image: ExrImage, rgb: list[str], alpha: str | None, matrix: np.ndarray | None = None, srgb: bool = False
) -> Samples:
    """Return the samples of an EXR part; half values at their largest (65504) or infinite count as clipped.

    Their lower bound is the part's largest value below 65504, or 65504 if none is above 0. Alpha becomes the weight.
    Pixels outside the data window have weight 0. matrix: (3, 3), from the file's RGB to Rec. 709, or None if the file
    holds Rec. 709. srgb: its values have the curve of sRGB.
    """
    colour = np.stack([image.channels[name] for name in rgb], axis=-1)
    clipped = np.zeros(colour.shape, bool)
    if colour.dtype == np.float16:
        clipped = colour >= _HALF_MAX
        if clipped.any():  # at 65504 a few such pixels would be white and all else black in every picture and figure
            colour[clipped] = colour[np.isfinite(colour) & ~clipped].max(initial=0) or _HALF_MAX
    if srgb:
        colour = linear_from_srgb(colour.astype(np.float32))
    if matrix is not None:
        clipped[:] = clipped.any(axis=-1, keepdims=True)  # the matrix mixes the channels
        with np.errstate(invalid="ignore"):
            colour = colour.astype(np.float64) @ matrix.T
    result = samples(colour.astype(np.float32), None if alpha is None else image.channels[alpha], clipped)
    result.rgba[~image.inside] = result.bounds[~image.inside] = 0
    return result


def write_exr(
    path: Path | str, parts: Mapping[str, Mapping[str, np.ndarray]], half: bool = False, turn: Turn | None = None
) -> None:
    """Write part name → channel name → (H, W), row 0 at the bottom, as a ZIP-compressed EXR file, whole or not at all.

    Floats are written as half if ``half`` is set, else as float; uint32 stays. A single part may be called "". turn: of
    the photograph, for cameras of other programs. Raises InputError if the path cannot be written, ValueError if shapes
    differ (all parts share one display window).
    """
    import OpenEXR

    path = Path(path)
    if len({np.shape(array) for channels in parts.values() for array in channels.values()}) != 1:
        raise ValueError(f"{path}: all channels of an EXR file must have one shape, and there must be some")
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    header |= dict(zip(TURN_NAMES, turn or (), strict=False))
    exr_parts = [
        OpenEXR.Part(dict(header), {c: _stored(array, half) for c, array in channels.items()}, name)
        for name, channels in parts.items()
    ]
    with replacing_file(path) as partial:
        try:
            OpenEXR.File(exr_parts).write(str(partial))
        except RuntimeError as error:
            raise OSError(str(error)) from error


def _stored(array: np.ndarray, half: bool) -> np.ndarray:
    array = np.asarray(array)
    kind = np.uint32 if array.dtype.kind == "u" else np.float16 if half else np.float32
    if kind is np.float16:
        array = np.clip(array, -_HALF_MAX, _HALF_MAX)  # the largest reads as clipped
    return np.ascontiguousarray(array[::-1], kind)
