"""Bursts: several photographs of one light, grouped by time or similarity, and averaged."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from ...capture.images.exif import SAME_STOPS, exposure_of, time_of
from ...capture.images.headers import read_bytes
from ...capture.images.image import ImageRef, ImageStore
from ...capture.inspect.checks import middle_window
from ...capture.inspect.frames import shrunk
from ...core.errors import InputError
from ...core.files import natural
from ..register import find_shifts, moved_back
from .brackets import Bracket
from .frames import Frame

KINDS = ("exif", "pictures")
_PAUSE = 1.0  # seconds: longest pause within a burst; EXIF often has whole seconds
_SIDE, _CROP = 48, 384  # pixels: longest side of the images that are compared, and of the crop that is registered
# Relative RMS of the square roots of normalised radiance, as in ``calibration.video``: lights 2° apart differ by 0.005.
_ALIKE, _DIFFERENT = 0.003, 0.01
_SAME_BRIGHTNESS = 0.02  # relative: under two lamps, images of a flat card may differ only in brightness
_MOVED = 0.5  # pixels
_MIN_LIGHTS = 3  # lights of a capture


def bursts_of(paths: Sequence[Path], by: str, store: ImageStore) -> tuple[list[Bracket], list[str]]:
    """Return photographs, sorted by name, as bursts (exposures 1), and warnings.

    by "exif": a burst has one exposure and no pause above a second. by "pictures": its photographs look the same.
    Raises InputError if a time is missing, the camera moved within a burst, or there is no burst.
    """
    paths = sorted(paths, key=natural)
    groups = list(_by_time(paths) if by == "exif" else _by_similarity(paths, store))
    sizes = [len(group) for group in groups]
    if max(sizes, default=0) < 2:
        raise InputError(f"{paths[0].parent}: no two photographs make a burst; omit --bursts")
    if len(sizes) < _MIN_LIGHTS:
        raise InputError(
            f"{paths[0].parent}: its {len(paths)} photographs show {len(sizes)} light{'s' * (len(sizes) > 1)} by"
            f" --bursts {by}; {_MIN_LIGHTS} or more are needed"
        )
    usual = max(set(sizes), key=sizes.count)
    warnings = [
        f"{group[0]}: its burst has {len(group)} photographs, the usual one {usual}; check that none is missing"
        for group in groups
        if len(group) != usual
    ]
    return [Bracket(group[0].stem, tuple(group), (1.0,) * len(group)) for group in groups], warnings


def averaged(
    read: Callable[[int], Frame], images: Sequence[ImageRef], align: bool
) -> tuple[np.ndarray, list[list[float]]]:
    """Read a burst frame by frame; return its mean (H, W, 4), and the shifts of its frames in pixels.

    Where a frame clips, the weight is 0 and the mean a lower bound. align: move shifted frames back. Raises InputError
    if their lights differ, or the camera moved and ``align`` is False.
    """
    rgba, crops = None, []
    for k in range(len(images)):
        frame = read(k)
        crops.append(_crop(frame.rgb.mean(axis=-1)))
        rgba = _accumulated(rgba, frame.rgb, frame.weight)
    middle = len(images) // 2
    shifts = find_shifts(np.stack(crops), middle).pixels
    distances = np.abs(shifts).max(axis=1)
    moved = distances > _MOVED
    if moved.any() and not align:
        worst = int(distances.argmax())
        raise InputError(
            f"{images[worst]}: the camera moved by {distances[worst]:.1f} pixels within its burst; leave it out, or add"
            " --register"
        )
    for k, image in enumerate(images):
        if _difference(crops[middle], crops[k], *shifts[k]) > _DIFFERENT:
            raise InputError(
                f"{image}: its light differs from that of {images[middle].path.name}, which is in its burst by the"
                " time; leave one of them out, or group by --bursts pictures"
            )
    if moved.any():
        rgba = None
        for k, (right, up) in enumerate(shifts):
            frame = read(k)
            back = moved_back(np.concatenate([frame.rgb, frame.weight[..., None]], axis=-1), right, up)
            rgba = _accumulated(rgba, back[..., :3], back[..., 3])
    assert rgba is not None
    rgba[..., :3] /= len(images)
    return rgba, shifts.round(4).tolist()


def _accumulated(rgba: np.ndarray | None, rgb: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Add a frame: radiances are summed, of weights the least is used."""
    added = np.concatenate([rgb, weight[..., None]], axis=-1).astype(np.float32)
    if rgba is None:
        return added
    rgba[..., :3] += added[..., :3]
    rgba[..., 3] = np.minimum(rgba[..., 3], added[..., 3])
    return rgba


def _by_time(paths: Sequence[Path]) -> Iterator[list[Path]]:
    group: list[Path] = []
    last: tuple[float, float] | None = None
    for path in paths:
        data = read_bytes(path)
        seconds, exposure = time_of(data), exposure_of(data)
        if seconds is None:
            raise InputError(f"{path}: has no time in its EXIF; use --bursts pictures")
        amount = exposure.amount if exposure else 1.0
        current = seconds, amount
        if last and 0 <= seconds - last[0] <= _PAUSE and abs(np.log2(amount / last[1])) < SAME_STOPS:
            group.append(path)
        else:
            if group:
                yield group
            group = [path]
        last = current
    if group:
        yield group


def _by_similarity(paths: Sequence[Path], store: ImageStore) -> Iterator[list[Path]]:
    """Yield runs of photographs similar to the first of the run. Raises InputError if only a shift separates runs."""
    group: list[Path] = []
    first: np.ndarray | None = None
    for path in paths:
        grey = store.samples(ImageRef(path)).rgba[..., :3].mean(axis=-1)
        if first is not None and first.shape == grey.shape:
            as_bright = abs(grey.mean() - first.mean()) <= _SAME_BRIGHTNESS * first.mean()
            if as_bright and _difference(first, grey) <= _ALIKE:
                group.append(path)
                continue
            _refuse_shift(first, grey, group[0], path)
        if group:
            yield group
        group, first = [path], grey
    if group:
        yield group


def _refuse_shift(first: np.ndarray, grey: np.ndarray, name: Path, path: Path) -> None:
    """Raise InputError if a photograph shows the same light, shifted."""
    crops = np.stack([_crop(first), _crop(grey)])
    right, up = find_shifts(crops).pixels[1]
    if max(abs(right), abs(up)) > _MOVED and _difference(crops[0], crops[1], right, up) <= _DIFFERENT:
        raise InputError(
            f"{path}: shows the light of {name.name}, but the camera moved by {np.hypot(right, up):.1f} pixels; leave"
            " it out"
        )


def _crop(grey: np.ndarray) -> np.ndarray:
    return grey[middle_window(np.ones(grey.shape, bool), _CROP)]


def _difference(grey: np.ndarray, other: np.ndarray, right: float = 0.0, up: float = 0.0) -> float:
    """Return the RMS difference, over blocks, of the square roots of two images over their means, less noise.

    The second image is first moved back by (right, up). The variance within blocks gives the noise of their means.
    """
    if max(abs(right), abs(up)) > _MOVED:
        back = moved_back(np.dstack([other] * 3 + [np.ones_like(other)]), right, up)
        grey, other = np.where(back[..., 3] > 0, grey, 0), np.where(back[..., 3] > 0, back[..., 0], 0)
    roots = [np.sqrt(np.maximum(one, 0, dtype=np.float64) / max(float(one.mean()), 1e-9)) for one in (grey, other)]
    difference = roots[1] - roots[0]
    factor = -(-max(difference.shape) // _SIDE)
    block = min(factor, difference.shape[0]), min(factor, difference.shape[1])
    means = shrunk(difference, block) ** 2
    noise = (shrunk(difference**2, block) - means) / max(block[0] * block[1] - 1, 1)
    return float(np.sqrt(max(float((means - noise).mean()), 0.0)))
