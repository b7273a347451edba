"""Detects damaged images of a capture by decoding each one, and excludes them on request."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from ...core.steps import blocking
from ..errors import CaptureError
from ..images.image import ImageRef, ImageStore
from ..images.linearise import Samples
from ..spec import CaptureSpec, common_size, size_fault
from ..types import LeftOut

# Codes of CaptureErrors about a single image.
DAMAGE = frozenset({"missing", "image_unknown", "image_truncated", "size", "image_nan"})
_REMEDY = "or leave it out with --skip-damaged"
_sizes: dict[tuple[Any, ...], tuple[int, int]] = {}  # of intact images, by file, its time and length


@contextmanager
def with_skip_remedy(skipping: bool) -> Iterator[None]:
    """Append the option that skips damaged images to their errors, unless ``skipping``."""
    try:
        yield
    except CaptureError as error:
        if skipping or error.code not in DAMAGE:
            raise
        raise CaptureError(f"{error.message}; {_REMEDY}", error.code, error.others) from error


def without_damaged_steps(spec: CaptureSpec, store: ImageStore) -> Generator[None, None, CaptureSpec]:
    """Return a spec with damaged images moved to ``left_out``. Raises CaptureError if none is intact.

    Yields before each image is decoded. A camera without intact images is removed. Faults of the list, such as an
    unknown EXR part, are left to ``build_capture``.
    """
    sizes: dict[int, tuple[int, int]] = {}
    why: dict[int, str] = {}
    for k, observation in enumerate(spec.observations):
        yield
        try:
            sizes[k] = _whole_size(observation.image, store)
        except CaptureError as error:
            if error.code in DAMAGE:
                why[k] = error.message
    for index, view in enumerate(spec.views):
        intact = {k: size for k, size in sizes.items() if spec.observations[k].camera == index}
        if not intact:
            continue
        expected = common_size(view, list(intact.values()))
        why |= {k: size_fault(spec.observations[k].image, size, expected).message
                for k, size in intact.items() if size != expected}  # fmt: skip
    if len(why) == len(spec.observations):
        raise CaptureError(f"{why[0]} (like all other images of {spec.source})", "list_empty")
    damaged = [(k, spec.observations[k]) for k in sorted(why)]
    left_out = tuple(LeftOut(k, str(observation.image), why[k], observation.name) for k, observation in damaged)
    remaining = [observation for k, observation in enumerate(spec.observations) if k not in why]
    unused = {observation.camera for observation in spec.observations} - {
        observation.camera for observation in remaining
    }
    views = [index for index in range(len(spec.views)) if index not in unused]
    observations = tuple(replace(observation, camera=views.index(observation.camera)) for observation in remaining)
    return replace(
        spec, observations=observations, views=tuple(spec.views[index] for index in views), left_out=left_out
    )


without_damaged = blocking("without_damaged", without_damaged_steps)


def check_numbers(image: ImageRef | str, samples: Samples) -> None:
    """Raise CaptureError if no pixel of an image is a number."""
    if samples.not_finite.all():
        raise CaptureError(f"{image}: none of its pixels is a number; render or export it again", "image_nan")


def _whole_size(image: ImageRef, store: ImageStore) -> tuple[int, int]:
    """Decode an image, once per version of its file; return (width, height)."""
    key = (image, *_stamp(image.path))
    if key not in _sizes:
        store.size(image)
        samples = store.samples(image)
        check_numbers(image, samples)
        height, width = samples.rgba.shape[:2]
        _sizes[key] = width, height
    return _sizes[key]


def _stamp(path: Path) -> tuple[int, int]:
    try:
        stat = path.stat()
    except OSError:  # reading the file reports the error
        return 0, 0
    return stat.st_mtime_ns, stat.st_size
