"""OpenCV, an optional library. The only module that imports it, at first use."""

from __future__ import annotations

import sys
from types import ModuleType

from .errors import InputError


def opencv(what: str) -> ModuleType:
    """Return the module ``cv2``. what: the work that needs it. Raises InputError if it is not installed."""
    try:
        import cv2
    except ImportError as error:
        raise InputError(f"{what} needs OpenCV; run {sys.executable} -m pip install opencv-python-headless") from error
    return cv2
