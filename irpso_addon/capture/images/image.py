"""``ImageRef`` and ``ImageStore``: one image of a capture in any format; its header, encoding and pixels."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Literal

import numpy as np

from ...core.errors import InputError
from ..errors import CaptureError
from .colour_profile import ColourProfile, ProfileError, adobe_rgb, profile_of_gamma, profile_of_h273, profile_of_icc
from .exif import Exposure, exposure_of
from .exr import ExrImage, colour_channels, load_exr, matrix_to_rec_709, samples_of_exr
from .exr_header import ExrPart, Turn, is_exr, read_exr_header
from .headers import ImageHeader, missing, read_bytes, read_header
from .heif import SUFFIXES as HEIF_SUFFIXES
from .heif import decode_heif
from .linearise import Decoder, Picture, Samples, mask_of_picture, samples_of_picture
from .raw import RawHeader, decode_raw, is_raw, raw_header

SUFFIXES = (".png", ".exr", ".tif", ".tiff", ".jpg", ".jpeg", ".hdr", *HEIF_SUFFIXES)  # of pictures, without raw files
# Source of an image's encoding: stated in the file, implied by the format or by 16 bits, or a guess.
KnownBy = Literal["file", "format", "depth", "guess"]


@dataclass(frozen=True)
class ImageRef:
    """Reference to an image: file, part of a multi-part EXR by name or number, layer, colour space.

    named_in: place of the file's name in the capture's files, for errors.
    """

    path: Path
    part: str | int | None = None
    layer: str | None = None
    colour_space: str = "auto"
    named_in: str = field(default="its name", compare=False)

    def __str__(self) -> str:
        return str(self.path) if self.part is None else f"{self.path}: part {self.part!r}"


@dataclass
class ImageStore:
    """Decodes images; caches headers and the unread parts of a multi-part EXR.

    OpenEXR's Python reader cannot read a single part: without the cache, a capture of K parts would be read K times.
    Reading a part removes it, so memory shrinks while a capture streams.
    """

    decoder: Decoder | None = None
    _headers: dict[Path, tuple[ExrPart, ...]] = field(default_factory=dict)
    _parts: dict[Path, dict[str, ExrImage]] = field(default_factory=dict)
    _pictures: dict[Path, ImageHeader] = field(default_factory=dict)
    _raws: dict[Path, RawHeader] = field(default_factory=dict)

    def encoding(self, image: ImageRef) -> tuple[str, KnownBy]:
        """Return the encoding under colour_space "auto", "srgb" or "linear", and its source.

        Files of 8 to 12 bits are sRGB unless they state to be linear; all others are linear, except integers that state
        sRGB or have a colour profile. Raises CaptureError, also for an unsupported profile.
        """
        if is_exr(image.path) or is_raw(image.path):
            return "linear", "format"
        header = self._header(image.path)
        profile = self.profile(image)
        if profile is not None and header.bits < 32:
            return "linear" if profile.linear else "srgb", "file"
        if header.states and header.bits < 32:
            return header.states, "file"
        if header.bits < 16:
            return "srgb", "guess"
        return "linear", "depth" if header.bits == 16 else "format"

    def coarse(self, image: ImageRef) -> bool:
        """Return whether an image's encoding is sRGB of 8 to 12 bits, before any test. Raises CaptureError."""
        if is_exr(image.path) or is_raw(image.path) or self._header(image.path).bits >= 16:
            return False
        return (self.encoding(image)[0] if image.colour_space == "auto" else image.colour_space) == "srgb"

    def profile(self, image: ImageRef) -> ColourProfile | None:
        """Return the colour profile of an image's file; None without one or for sRGB.

        Also None where the image's colour space is given, which overrides it. Raises CaptureError.
        """
        if is_exr(image.path) or is_raw(image.path) or image.colour_space != "auto":
            return None
        header = self._header(image.path)
        try:
            if header.icc:
                profile = profile_of_icc(header.icc)
            elif header.cicp:
                profile = profile_of_h273(*header.cicp)
            elif header.adobe_rgb:
                profile = adobe_rgb()
            elif header.gamma:
                profile = profile_of_gamma(header.gamma)
            else:
                return None
        except ProfileError as error:
            raise CaptureError(
                f"{image.path}: {error}; save it with the profile sRGB or Display P3, or set --colour-space srgb"
                " (Color Space) to ignore the profile",
                "profile",
            ) from error
        return None if profile.srgb and header.bits < 16 else profile

    def _header(self, path: Path) -> ImageHeader:
        """Return the header of an image that is no EXR. The first call reads the whole file."""
        if path not in self._pictures:
            self._pictures[path] = read_header(path)
        return self._pictures[path]

    def _raw_header(self, path: Path) -> RawHeader:
        if path not in self._raws:
            self._raws[path] = raw_header(path)
        return self._raws[path]

    def size(self, image: ImageRef) -> tuple[int, int]:
        """Return (width, height) from the file's header. Raises CaptureError if it cannot be read."""
        with suppress(OSError):  # a folder without permission: reading reports it
            if not image.path.exists():
                raise missing(image.path, image.named_in)
        if is_exr(image.path):
            part = self._part(image)
            colour_channels(part, image.layer, str(image))
            return part.width, part.height
        if image.part is not None or image.layer is not None:
            read_header(image.path)  # raises if the file is no image
            raise CaptureError(f"{image.path}: only EXR files have parts and layers; remove part and layer", "layer")
        if is_raw(image.path):
            raw = self._raw_header(image.path)
            return raw.width, raw.height
        header = self._header(image.path)
        if self.decoder is None and header.kind != "HEIF":
            raise self._no_decoder(image)
        return header.width, header.height

    def orientation(self, image: ImageRef) -> int:
        """Return the EXIF orientation that reading a file applies, 1 for none."""
        return 1 if is_exr(image.path) or is_raw(image.path) else self._header(image.path).orientation

    def turn(self, image: ImageRef) -> Turn | None:
        """Return how a picture is turned from its stored state; of an EXR as ``develop`` recorded it, else None.

        Of HEIC files ``turned_by`` is 1, as other programs see them upright.
        """
        if is_exr(image.path):
            return self._part(image).turn
        if is_raw(image.path):
            tag = self._raw_header(image.path).tag
            return Turn(tag, tag)
        header = self._header(image.path)
        return Turn(header.tag, header.orientation)

    def tag(self, image: ImageRef) -> int | None:
        """Return the EXIF orientation of the camera's file, also where its decoder applies it; None if unknown."""
        turn = self.turn(image)
        return None if turn is None else turn.tag

    def turned_by(self, image: ImageRef) -> int:
        """Return the EXIF orientation by which a camera's stored picture was turned, 1 for none or an unknown one."""
        turn = self.turn(image)
        return 1 if turn is None else turn.turned_by

    def exposure(self, image: ImageRef) -> Exposure | None:
        """Return the exposure by EXIF, None without one. Raises CaptureError if the file cannot be read."""
        if is_exr(image.path):
            return None
        return exposure_of(read_bytes(image.path)) if is_raw(image.path) else self._header(image.path).exposure

    def samples(self, image: ImageRef) -> Samples:
        """Return an image's linear radiance and weight."""
        if not is_exr(image.path):
            return self.samples_of(image, self.picture(image))
        part = self._part(image)
        rgb, alpha = colour_channels(part, image.layer, str(image))
        matrix, srgb = matrix_to_rec_709(part, rgb, str(image)), image.colour_space == "srgb"
        return samples_of_exr(self._pixels(image.path, part), rgb, alpha, matrix, srgb)

    def samples_of(self, image: ImageRef, picture: Picture) -> Samples:
        """Return ``samples`` of an image that is no EXR. picture: its code values."""
        space = image.colour_space
        if space == "auto" and picture.profile is None:
            space = self.encoding(image)[0]
        return samples_of_picture(picture, space)

    def codes_at(self, image: ImageRef, places: np.ndarray, size: tuple[int, ...]) -> np.ndarray | None:
        """Return (n, 4) the code values and weights of an image's pixels (n,), numbered row by row.

        None if the image's size is not ``size``, (H, W). Converting all pixels of a large photograph takes ten times
        as long as decoding it.
        """
        if is_exr(image.path):
            rgba = self.samples(image).rgba
            return rgba.reshape(-1, 4)[places] if rgba.shape[:2] == size else None
        picture = self.picture(image)
        if picture.values.shape[:2] != size:
            return None
        values = picture.values.reshape(-1, picture.values.shape[-1])[places]
        return samples_of_picture(replace(picture, values=values[None]), "linear").rgba[0]

    def mask(self, image: ImageRef) -> np.ndarray:
        """Return an image as a mask, (H, W) bool."""
        if not is_exr(image.path):
            return mask_of_picture(self.picture(replace(image, colour_space="linear")))  # ignores its profile
        part = self._part(image)
        rgb, alpha = colour_channels(part, image.layer, str(image))
        channels = self._pixels(image.path, part).channels
        names = rgb if alpha is None else [*rgb, alpha]
        return mask_of_picture(Picture(np.stack([channels[n].astype(np.float32) for n in names], axis=-1), 32))

    def picture(self, image: ImageRef) -> Picture:
        """Return the code values of an image that is no EXR, and its colour profile; raw files without a curve."""
        if is_raw(image.path):
            return decode_raw(image.path)
        profile = self.profile(image)
        if self._header(image.path).kind == "HEIF":
            return replace(decode_heif(image.path, read_bytes(image.path)), profile=profile)
        if self.decoder is None:
            raise self._no_decoder(image)
        try:
            return replace(self.decoder(image.path), profile=profile)
        except CaptureError:
            raise
        except InputError as error:  # decoders give no code
            raise CaptureError(str(error), "image_truncated") from error

    def _no_decoder(self, image: ImageRef) -> CaptureError:
        return CaptureError(
            f"{image.path}: is a {self._header(image.path).kind} file, and only EXR can be read without Blender; give"
            " read_capture a decoder (irpso_addon.blender.images.decode) or convert the image to EXR",
            "no_decoder",
        )

    def _part(self, image: ImageRef) -> ExrPart:
        if image.path not in self._headers:
            self._headers[image.path] = read_exr_header(image.path)
        parts = self._headers[image.path]
        wanted = image.part
        if isinstance(wanted, int) and 0 <= wanted < len(parts):
            return parts[wanted]
        if wanted is None and len(parts) == 1:
            return parts[0]
        named = [part for part in parts if part.name == wanted and wanted is not None]
        if not named:
            what = "has several parts" if wanted is None else f"has no part {wanted!r}"
            some = ", ".join(repr(part.name) for part in parts[:6] if part.name) + (", …" if len(parts) > 6 else "")
            remedy = (
                f"set part in a capture.toml to one it has ({some})" if some else "take part out: it has one, unnamed"
            )
            raise CaptureError(f"{image.path}: {what}; {remedy}", "part")
        return named[0]

    def _pixels(self, path: Path, part: ExrPart) -> ExrImage:
        several = len(self._headers[path]) > 1
        parts = self._parts.get(path, {})
        if part.name not in parts:
            parts = load_exr(path)
        image = parts.pop(part.name, None)
        if image is None or set(image.channels) != set(part.channels):
            raise CaptureError(f"{path}: has changed since it was opened; start again once it is complete", "changed")
        if several:
            self._parts[path] = parts
        return image


def find_image(folder: Path, name: str) -> Path:
    """Return the path of a listed image; names may be relative, absolute, or stale paths of another machine.

    Tried in order: the name itself; its last part beside the list; the last part in any letter case. Without a match
    the path has no file, and reading it raises.
    """
    if (folder / name).is_file():
        return folder / name
    # On POSIX the backslashes of a Windows path are part of the name, so both systems' rules are tried.
    for last in (PurePosixPath(name).name, PureWindowsPath(name).name):
        if (folder / last).is_file():
            return folder / last
        same = [path for path in sorted(folder.iterdir()) if path.name.lower() == last.lower()]
        if same:
            return same[0]
    return folder / PureWindowsPath(name).name
