"""OpenCV, an optional library: the only module that imports cv2."""

from __future__ import annotations

import sys
from typing import Any

from .errors import InputError


def opencv(what: str) -> Any:
    """Return the module cv2. what: what needs it, for the message. Raises InputError where it is not installed."""
    try:
        import cv2
    except ModuleNotFoundError as error:
        raise InputError(
            f"{what} needs OpenCV, which this Python has not; `{sys.executable} -m pip install opencv-python-headless`"
        ) from error
    return cv2
