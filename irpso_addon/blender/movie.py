"""Frames of a video, decoded by Blender's movie reader. No scene is touched, so it works in a window too.

Measured on bpy 5.0.1: ``pixels`` of a movie image holds the frame that was read last, and the evaluation of an image
texture at a point reads the frame of its image user. As data, 8-bit frames are the video's code values.
"""

from __future__ import annotations

import mmap
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..capture.images.linearise import Picture
from ..core.errors import InputError
from .colour_spaces import use_space
from .images import loaded

_UNSPECIFIED, _REC709 = 2, 1  # codes of ITU-T H.273
# Elements of Matroska: its head, the tracks and the pictures behind them, and in a track its colours.
_MATROSKA, _TRACKS, _CLUSTER = bytes.fromhex("1a45dfa3"), bytes.fromhex("1654ae6b"), bytes.fromhex("1f43b675")
_COLOUR, _PRIMARIES, _TRANSFER = bytes.fromhex("55b0"), bytes.fromhex("55bb"), bytes.fromhex("55ba")
_CACHED = 16  # frames that Blender caches: 8 MB each at 1920 × 1080


@dataclass(frozen=True, eq=False)
class Movie:
    """An open video. size: (width, height). cicp: colour primaries and transfer function by ITU-T H.273."""

    path: Path
    size: tuple[int, int]
    frames: int
    cicp: tuple[int, int]
    _texture: Any

    def frame(self, index: int) -> Picture:
        """Return a frame's RGB code values, from 0; bits are 8, or 16 for finer videos. Raises InputError."""
        user, image = self._texture.image_user, self._texture.image
        if index % _CACHED == 0:
            image.buffers_free()
        user.frame_current = index + 1
        self._texture.evaluate((0.0, 0.0, 0.0))
        values = np.empty(self.size[0] * self.size[1] * image.channels, np.float32)
        try:
            image.pixels.foreach_get(values)
        except (RuntimeError, TypeError) as error:
            raise InputError(f"{self.path}: frame {index + 1} cannot be decoded; convert the video to MP4") from error
        rgb = values.reshape(self.size[1], self.size[0], -1)[..., :3]
        return Picture(np.ascontiguousarray(rgb), 16 if image.is_float else 8)


@contextmanager
def opened_movie(path: Path) -> Iterator[Movie]:
    """Yield an open video, closed at the end. Raises InputError if Blender cannot decode it."""
    import bpy

    if path.is_dir():
        raise InputError(f"{path}: holds no video; give a video, or a folder of videos")
    if not path.is_file():
        raise InputError(f"{path}: there is no such file; give a video")
    image = loaded(path)
    texture = bpy.data.textures.new("IRPSO frames", "IMAGE")
    try:
        use_space(image, "data")
        if image.source != "MOVIE" or not min(image.size) or image.frame_duration < 1:
            raise InputError(f"{path}: is no video that Blender can decode; convert it to MP4 (H.264)")
        texture.image, user = image, texture.image_user
        user.frame_start, user.frame_duration, user.use_auto_refresh = 1, image.frame_duration, False
        yield Movie(path, (image.size[0], image.size[1]), image.frame_duration, cicp_of(path), texture)
    finally:
        bpy.data.textures.remove(texture)
        bpy.data.images.remove(image)


def cicp_of(path: Path) -> tuple[int, int]:
    """Return colour primaries and transfer function of a video by ITU-T H.273; Rec. 709 where its file has none.

    Read from the box colr of MP4 and MOV files (ISO/IEC 14496-12, 12.1.5), and the element Colour of MKV and WebM (RFC
    9559, 5.1.4.1.28.16).
    """
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        if data[:4] == _MATROSKA:
            primaries, transfer = _matroska_codes(data)
        else:
            at = max(data.find(b"colrnclx"), data.find(b"colrnclc"))
            codes = data[at + 8 : at + 12] if at >= 0 else b""
            primaries, transfer = (int.from_bytes(codes[i : i + 2], "big") for i in (0, 2))
    known = [_REC709 if code in (0, _UNSPECIFIED) else code for code in (primaries, transfer)]
    return known[0], known[1]


def _matroska_codes(data: mmap.mmap) -> tuple[int, int]:
    """Return primaries and transfer function of a Matroska file, 0 for a missing one."""
    tracks = data.find(_TRACKS)
    at = data.find(_COLOUR, tracks, data.find(_CLUSTER, tracks)) if tracks >= 0 else -1
    if at < 0:
        return 0, 0
    lead = 9 - data[at + 2].bit_length()  # bytes of the size, by its leading zeros
    start = at + 2 + lead
    size = int.from_bytes(data[at + 2 : start], "big") - (1 << 7 * lead)
    colours = data[start : start + size]
    codes = []
    for element in (_PRIMARIES, _TRANSFER):
        place = colours.find(element)
        long = colours[place + 2] & 0x7F if place >= 0 else 0
        codes.append(int.from_bytes(colours[place + 3 : place + 3 + long], "big"))
    return codes[0], codes[1]
