"""Assignment of photographs to a rig's lamps, and checks of their camera, lens and exposure."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path

from ...capture.images.exif import SAME_STOPS
from ...capture.images.image import ImageStore
from ...core.errors import InputError
from ...core.files import natural
from ..developing.corrections_file import Photograph
from ..radiometry.develop import ExposureGroup
from .rig import Rig

_SAME_LENGTH = 0.01  # relative difference of focal lengths
_SUFFIXES = {".jpeg": ".jpg", ".tiff": ".tif"}


def matched(rig: Rig, names: Sequence[str], way: str, where: str) -> list[int]:
    """Return the lamp of each photograph. names: without suffixes. where: names the photographs in errors.

    way: "order" of the names (natural sort); equal "names"; the last "numbers" in names; or "auto": names if all are
    equal, else order. Raises InputError if a photograph has no lamp, or the numbers of both differ for "order".
    """
    lamps = distinct([Path(photograph.file).stem for photograph in rig.photographs],
                     [observation.name for observation in rig.spec.observations])  # fmt: skip
    for whose, called in ((rig.path, lamps), (where, names)):
        twice = next((name for n, name in enumerate(called) if name in called[:n]), None)
        if twice and len(rig.spec.views) > 1:
            raise InputError(
                f"{whose}: several photographs are called {twice}, as those of two cameras, and nothing says whose is"
                " whose; give each file a name of its own, as in cam1_01.jpg"
            )
    keys = {"names": str.lower, "numbers": _number}
    if way == "auto":
        way = "names" if sorted(map(str.lower, names)) == sorted(map(str.lower, lamps)) else "order"
    if way == "order":
        if len(names) != len(lamps):
            raise InputError(
                f"{where}: has {len(names)} photographs, the rig {rig.path} {len(lamps)} lamps; photograph each lamp"
                " once, or choose --match names or --match numbers"
            )
        by_name = sorted(range(len(lamps)), key=lambda n: natural(lamps[n]))
        order = sorted(range(len(names)), key=lambda n: natural(names[n]))
        return [by_name[order.index(n)] for n in range(len(names))]
    lamp_keys = [keys[way](lamp) for lamp in lamps]
    photograph_keys = [keys[way](name) for name in names]
    for what, owner, listed in ((lamps, rig.path, lamp_keys), (names, where, photograph_keys)):
        for n, key in enumerate(listed):
            if key is None:
                raise InputError(f"{owner}: {what[n]} has no number in its name; choose --match order")
            if key in listed[:n]:
                raise InputError(
                    f"{owner}: {what[n]} and {what[listed.index(key)]} are the same by --match {way};"
                    " choose --match order"
                )
    for name, key in zip(names, photograph_keys, strict=True):
        if key not in lamp_keys:
            raise InputError(
                f"{where}: {name} matches no lamp of the rig by --match {way}; the lamps are {_some(lamps)}"
            )
    return [lamp_keys.index(key) for key in photograph_keys]


def distinct(names: Sequence[str], others: Sequence[str]) -> list[str]:
    """Return names, or, where two are equal, as of files in two folders, the others."""
    return list(names if len(set(names)) == len(names) else others)


def check_photographs(
    rig: Rig, groups: Sequence[ExposureGroup], sources: Sequence[Photograph], lamps: Sequence[int], store: ImageStore
) -> None:
    """Raise InputError for the first photograph of another size, orientation, camera, lens or kind than the rig's.

    sources: the photograph of each group, with its EXIF.
    """
    for group, source, lamp in zip(groups, sources, lamps, strict=True):
        path, expected = group.images[0].path, rig.photographs[lamp]
        view, size = rig.spec.views[rig.spec.observations[lamp].camera], store.size(group.images[0])
        if view.size is not None and size != view.size:
            raise InputError(
                f"{path}: is {size[0]}×{size[1]} pixels, the rig's photographs {view.size[0]}×{view.size[1]}; set the"
                " camera as for the rig, and do not crop"
            )
        kind, of_rig = file_kind(path.name), file_kind(expected.file)
        if rig.measured is not None and kind != of_rig:
            raise InputError(
                f"{path}: is a {kind} file, and the rig's corrections are for {of_rig} files; give the camera's own"
                " files as for the rig"
            )
        if None not in (expected.orientation, source.orientation) and source.orientation != expected.orientation:
            raise InputError(
                f"{path}: its EXIF orientation is {source.orientation}, that of the rig's photographs"
                f" {expected.orientation}: it would be turned against the lamps; give all of them the same orientation"
            )
        for key, value in expected.lens.items():
            if key in source.lens and not _same(source.lens[key], value):
                raise InputError(
                    f"{path}: was taken with {key.replace('_', ' ')} {_shown(source.lens[key])}, the rig's photographs"
                    f" with {_shown(value)}; calibrate a rig for this camera and lens"
                )


def check_exposures(
    rig: Rig, groups: Sequence[ExposureGroup], sources: Sequence[Photograph], lamps: Sequence[int]
) -> None:
    """Raise InputError for the first photograph whose exposure, by EXIF, is not that of the rig's."""
    for group, photograph, lamp in zip(groups, sources, lamps, strict=True):
        expected, actual = rig.photographs[lamp].exposure, photograph.exposure
        if expected is None or actual is None:
            continue
        stops = math.log2(actual.amount / expected.amount)
        if abs(stops) >= SAME_STOPS:
            raise InputError(
                f"{group.images[0].path}: is exposed {abs(stops):.1f} stops {'more' if stops > 0 else 'less'} than the"
                " rig's photographs; set the camera as for the rig, or scale with --exposure exif"
            )


def rig_exposure(rig: Rig) -> float:
    """Return the common exposure of a rig's photographs, by EXIF. Raises InputError if they have none, or several."""
    amounts = [photograph.exposure.amount for photograph in rig.photographs if photograph.exposure]
    if len(amounts) < len(rig.photographs):
        raise InputError(f"--exposure exif: the photographs of the rig {rig.path} had no exposure in their EXIF")
    if max(amounts) / min(amounts) >= 2**SAME_STOPS:
        raise InputError(f"--exposure exif: the photographs of the rig {rig.path} had several exposures")
    return amounts[0]


def _number(name: str) -> int | None:
    numbers = re.findall(r"\d+", name)
    return int(numbers[-1]) if numbers else None


def file_kind(name: str) -> str:
    """Return the suffix of an image file, one of all that its format has."""
    suffix = Path(name).suffix.lower()
    return _SUFFIXES.get(suffix, suffix)


def _same(one: str | float, other: str | float) -> bool:
    if isinstance(one, str) or isinstance(other, str):
        return one == other
    return abs(one / other - 1) < _SAME_LENGTH


def _shown(value: str | float) -> str:
    return value if isinstance(value, str) else f"{value:g} mm"


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:4]) + (", …" if len(names) > 4 else "")
