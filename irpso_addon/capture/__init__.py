"""Captures: images of one subject with lights and cameras. One reader per format; no Blender.

Formats other than EXR need a decoder from the caller: ``irpso_addon.blender.images.decode`` is Blender's.
"""

from .camera import Camera
from .errors import CaptureError
from .framing import Framing, framed
from .images.exr import read_exr, write_exr
from .images.linearise import Decoder, Picture
from .read import read_capture
from .types import Capture, Light, Observation
from .write import write_capture

__all__ = [
    "Camera", "Capture", "CaptureError", "Decoder", "Framing", "Light", "Observation", "Picture", "framed",
    "read_capture", "read_exr",
    "write_capture", "write_exr",
]  # fmt: skip
