"""Options of ``develop`` and ``response``: photographs, patches and exposures; errors name the option."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...calibration.developing.greys import AUTO
from ...calibration.radiometry.frames import Patch
from ...calibration.radiometry.source import images_in
from ...core.errors import InputError
from .values import numbers_of_text


def files_option(option: str, names: Sequence[str] | None) -> list[Path]:
    """Return the images of an option that takes files and folders. Raises InputError if one is missing."""
    files: list[Path] = []
    for name in names or ():
        path = Path(name)
        if not path.exists():
            raise InputError(f"{option} {name}: is not there; give image files, or folders of them")
        images = images_in(path) if path.is_dir() else [path]
        if not images:
            raise InputError(f"{option} {name}: holds no images; give image files, or folders of them")
        files += images
    return files


def number_list(option: str, text: str) -> list[float]:
    """Return numbers separated by commas. Raises InputError."""
    numbers = numbers_of_text(text)
    if numbers is None:
        raise InputError(f"{option} {text}: give numbers separated by commas")
    return numbers


def exposures_option(text: str | None, source: str | None) -> tuple[float, ...]:
    """Return the exposures of --exposures, such as "1/60,1/15,0.25"; () for None. Raises InputError.

    source: of the exposures, as of ``Exposing``.
    """
    if text is None:
        return ()
    if source != "names":
        raise InputError("--exposures lists what the numbers at the end of names stand for; add --brackets names")
    values = []
    for part in text.split(","):
        top, slash, bottom = part.strip().partition("/")
        try:
            value = float(top) / float(bottom) if slash else float(top)
        except (ValueError, ZeroDivisionError):
            value = float("nan")
        if not 0 < value < float("inf"):
            raise InputError(f"--exposures {text}: give exposures above 0, as in --exposures 1/60,1/15,1/4")
        values.append(value)
    return tuple(values)


def patch_option(option: str, text: str) -> Patch:
    """Return the patch of "X,Y,W,H" or "X,Y,W,H=REFLECTANCE". Raises InputError."""
    place, equals, value = text.partition("=")
    numbers = number_list(option, place)
    if len(numbers) != 4 or not all(np.isfinite(number) and number == int(number) >= 0 for number in numbers):
        raise InputError(f"{option} {text}: write X,Y,W,H in pixels from the upper left corner, as 100,220,40,40")
    return Patch(*(int(number) for number in numbers), reflectance_of(option, text, value) if equals else None)


def reflectance_of(option: str, text: str, value: str) -> float:
    """Return the reflectance after the = of an option's text. Raises InputError."""
    (reflectance, *more) = number_list(option, value)
    if more or not 0 < reflectance <= 1:
        raise InputError(f"{option} {text}: a reflectance is above 0 and at most 1, as in =0.18")
    return reflectance


def greys_option(texts: Sequence[str] | None) -> tuple[Patch, ...] | str:
    """Return the patches of --grey-card, or "auto". Raises InputError."""
    if AUTO in (texts or ()):
        if len(texts or ()) > 1:
            raise InputError(f"--grey-card {AUTO}: finds all greys of the chart; omit the other --grey-card")
        return AUTO
    return tuple(patch_option("--grey-card", text) for text in texts or ())


def corners_option(option: str, text: str) -> np.ndarray:
    """Return the corners (4, 2) of "X1,Y1,…,X4,Y4". Raises InputError."""
    numbers = np.array(number_list(option, text))
    if len(numbers) != 8 or not np.isfinite(numbers).all():
        raise InputError(f"{option} {text}: write X1,Y1,X2,Y2,X3,Y3,X4,Y4, four corners in pixels")
    return numbers.reshape(4, 2)
