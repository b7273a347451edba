"""Reads captures of all formats: ``read_capture`` detects the format of a path."""

from __future__ import annotations

from pathlib import Path

from .errors import CaptureError
from .formats.registry import FORMATS, captures_in, format_of
from .framing import Framing, framed
from .images.image import ImageStore
from .images.linearise import COLOUR_SPACES, Decoder
from .inspect.damage import without_damaged
from .spec import CaptureSpec, build_capture
from .types import Capture

*_FIRST, _LAST = (known.folder_holds for known in FORMATS)
_REMEDY = f"a capture is a folder with {', with '.join(_FIRST)}, or with {_LAST}"
_NO_LIGHTS = "of photographs irpso calibrate, or Find Lights, makes one"


def read_capture(
    path: Path | str,
    decoder: Decoder | None = None,
    colour_space: str = "auto",
    skip_damaged: bool = False,
    framing: Framing | None = None,
) -> Capture:
    """Read a capture: a folder, a .lp file or a capture.toml. Images are decoded at first use.

    Layouts: docs/capture_format.md; DiLiGenT (Shi et al. 2016), RTI (Malzbender et al. 2001), a table of our own.
    Images become linear Rec. 709 radiance, (H, W, 4) float32, row 0 at the bottom, with a weight of 0…1 in alpha.
    decoder: reads formats other than EXR (``irpso_addon.blender.images.decode`` is one); without it they are an error.
    colour_space: "srgb", "linear", or "auto": 8-bit files are sRGB unless they state or clearly show that they are
    linear (``encoding.py``), all others linear. skip_damaged: leave out images that cannot be decoded, and list them in
    the capture; this decodes each image once now. framing: replaces that of the files. Raises InputError naming the
    file and the remedy.
    """
    spec = read_spec(path, colour_space)
    return framed(whole_capture(spec, decoder, skip_damaged), spec.framing if framing is None else framing)


def whole_capture(spec: CaptureSpec, decoder: Decoder | None = None, skip_damaged: bool = False) -> Capture:
    """Return the capture of a spec without applying its framing. Parameters, errors: as read_capture."""
    return build_capture(without_damaged(spec, ImageStore(decoder)) if skip_damaged else spec, decoder)


def read_spec(path: Path | str, colour_space: str = "auto") -> CaptureSpec:
    """Read a capture's lists of images and lights, but no image. Raises InputError as read_capture does."""
    path = Path(path)
    if colour_space not in COLOUR_SPACES:
        raise CaptureError(
            f"colour space '{colour_space}' is unknown; choose one of {', '.join(COLOUR_SPACES)}", "value"
        )
    try:
        if path.is_dir():
            return _spec_of_folder(path, colour_space)
        if not path.exists():
            raise CaptureError(f"{path}: is not there; give the path of a capture ({_REMEDY})", "capture")
    except PermissionError as error:
        raise CaptureError(f"{path}: cannot be opened; check its permissions", "missing") from error
    if known := format_of(path):
        return known.read(path, colour_space)
    if path.suffix.lower() == ".blend":
        raise CaptureError(
            f"{path}: a scene is checked in Blender, with Capture From: This Scene; recover reads it", "kind"
        )
    raise CaptureError(f"{path}: is no capture; {_REMEDY}", "kind")


def _spec_of_folder(folder: Path, colour_space: str) -> CaptureSpec:
    found = captures_in(folder)
    if found is None:
        raise CaptureError(f"{folder}: holds no capture; {_REMEDY}; {_NO_LIGHTS}", "kind")
    known, captures = found
    if len(captures) > 1:
        what = f"{len(captures)} {captures[0].suffix.lower()} files"
        raise CaptureError(f"{folder}: holds {what}; give the path of the one to read", "kind")
    return known.read(captures[0], colour_space)
