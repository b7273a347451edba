"""Reads captures of reflectance transformation imaging: a .lp list of light positions (Malzbender et al. 2001)."""

from __future__ import annotations

from pathlib import Path

from ..errors import CaptureError
from ..images.image import ImageRef, find_image
from ..spec import CaptureKind, CaptureSpec, ObservationSpec, ViewSpec
from .lists import numbers, read_lines
from .toml_file import camera_maker

_DIGITS = 10  # a count has fewer


def spec_of_lp(path: Path, colour_space: str = "auto") -> CaptureSpec:
    """Return the spec of a .lp file: a count, then lines of ``name x y z``; names may hold spaces.

    Its positions lie on a dome of unknown radius and are used as directions. The camera is orthographic. Raises
    CaptureError if the count or a line is wrong.
    """
    remedy = "write the number of images, then one line for each: name x y z"
    (first, count), *rows = read_lines(path, remedy)
    if not (count.isdecimal() and len(count) < _DIGITS):
        raise CaptureError(f"{path}: line {first}: '{count[:40]}' is not a number of images; {remedy}", "count")
    if int(count) != len(rows):
        raise CaptureError(f"{path}: says {count} images and lists {len(rows)}; correct the first line", "count")
    if not rows:
        raise CaptureError(f"{path}: lists no images; {remedy}", "list_empty")
    observations = []
    for line, row in rows:
        where = f"{path}: line {line}"
        # Split from the right, because names may hold spaces.
        words = row.rsplit(maxsplit=3)
        if len(words) != 4:
            raise CaptureError(f"{where}: is not 'name x y z'; complete it", "light_columns")
        name = words[0].strip("\"'")
        image = ImageRef(find_image(path.parent, name), colour_space=colour_space, named_in=f"its name in {where}")
        observations.append(ObservationSpec(image.path.name, image, tuple(numbers(words[1:], where)), where))
    view = ViewSpec("camera", camera_maker({}, str(path)), str(path), lens=False)
    return CaptureSpec(path.resolve().parent.name, CaptureKind.RTI, path, tuple(observations), (view,))
