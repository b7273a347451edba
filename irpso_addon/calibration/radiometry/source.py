"""Photographs to develop: those that a capture lists, or all of a folder; single, in brackets or in bursts."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...capture.formats.diligent import FILENAMES, is_mask, mask_of
from ...capture.formats.lists import read_lines
from ...capture.formats.registry import captures_with_lights
from ...capture.framing import Framing
from ...capture.images.exif import exposure_of
from ...capture.images.exr_header import is_exr
from ...capture.images.headers import read_bytes
from ...capture.images.image import ImageRef, ImageStore, find_image
from ...capture.images.linearise import Decoder
from ...capture.read import read_spec
from ...capture.spec import CaptureSpec, build_capture
from ...capture.types import Capture
from ...core.errors import InputError
from ...core.files import natural, visible
from ..photographs import CAMERA, is_photograph
from .brackets import Bracket, amounts_of, brackets_of, name_amount
from .bursts import bursts_of
from .develop import ExposureGroup

_SAME_LIGHT_DEGREES = 0.01


@dataclass(frozen=True)
class Exposing:
    """Source of exposures. by: "exif" or "names". merged: photographs of one light form a bracket.

    exposures: indexed by the numbers at the end of names.
    """

    by: str
    merged: bool
    exposures: tuple[float, ...] = ()


@dataclass(frozen=True)
class Source:
    """Photographs to develop. capture: lights, cameras and masks of the groups, in their order; None for a folder.

    framing: of the capture's files; the groups are whole. copied: a folder's camera.toml and mask.
    """

    groups: tuple[ExposureGroup, ...]
    capture: Capture | None
    warnings: tuple[str, ...] = ()
    framing: Framing = Framing()
    copied: tuple[Path, ...] = ()


def images_in(folder: Path) -> list[Path]:
    """Return the images of a folder, by suffix, in natural order."""
    try:
        files = [p for p in visible(folder) if p.is_file()]
    except OSError as error:
        raise InputError(f"{folder}: cannot be opened ({error.strerror}); give a folder of photographs") from error
    return sorted(filter(is_photograph, files), key=natural)


def read_source(
    path: Path | str,
    decoder: Decoder | None = None,
    exposing: Exposing | None = None,
    colour_space: str = "auto",
    left_out: Sequence[Path] = (),
    bursts: str | None = None,
) -> Source:
    """Return the photographs to develop of a capture or a folder.

    left_out: files that do not show the subject, such as dark frames. bursts: grouping, one of ``bursts.KINDS``, or
    None. Raises InputError if no photograph is left, or an exposure is unknown.
    """
    if bursts and exposing:
        raise InputError("--bursts averages photographs of one exposure; omit --brackets and --exposure")
    path = Path(path)
    excluded = {p.resolve() for p in left_out}
    if captures_with_lights(path) if path.is_dir() else path.is_file():  # of several, read_spec says to choose one
        return _listed_source(read_spec(path, colour_space), decoder, exposing, excluded, bursts)
    if not path.is_dir():
        raise InputError(f"{path}: is neither a capture nor a folder of photographs")
    images = [p for p in images_in(path) if p.resolve() not in excluded and not is_mask(p)]
    listed = _names(path) if (path / FILENAMES).exists() else images
    listed = [p for p in listed if p.resolve() not in excluded]
    if not listed:
        raise InputError(f"{path}: holds no photographs (PNG, JPEG, TIFF, HEIC, EXR, HDR or raw); give their folder")
    merged = bursts or (exposing and exposing.merged)
    brackets, warnings = _grouped(
        list(dict.fromkeys([*listed, *images])) if merged else listed, exposing, bursts, decoder
    )
    # A list may name one photograph of each bracket; its order is that of the lights.
    place = {path: number for number, path in reversed(list(enumerate(listed)))}
    brackets = [bracket for bracket in brackets if not place.keys().isdisjoint(bracket.paths)]
    brackets.sort(key=lambda bracket: min(place[path] for path in bracket.paths if path in place))
    groups = [
        ExposureGroup(b.name, tuple(ImageRef(p, colour_space=colour_space) for p in b.paths), b.amounts)
        for b in brackets
    ]
    if exposing is None:
        groups = [replace(group, amounts=None) for group in groups]
    names: set[str] = set()
    for group in groups:
        if group.name in names:
            raise InputError(f"{group.images[0]}: another photograph has this name; remove or rename it")
        names.add(group.name)
    size = ImageStore(decoder).size(groups[0].images[0])
    copied = tuple(p for p in (path / CAMERA, mask_of(path, excluded)) if p and p.is_file())
    return Source(tuple(replace(group, size=size) for group in groups), None, tuple(warnings), copied=copied)


def _names(folder: Path) -> list[Path]:
    """Return the images that the filenames.txt of a folder lists."""
    lines = read_lines(folder / FILENAMES, "write the image names into it")
    return [find_image(folder, name) for _, name in lines]


def brackets_of_images(paths: Sequence[Path], exposing: Exposing | None) -> tuple[list[Bracket], list[str]]:
    """Return photographs as brackets, of one photograph each if they are not merged, and warnings."""
    if exposing is None:
        return [Bracket(path.stem, (path,), (1.0,)) for path in paths], []
    if exposing.merged:
        return brackets_of(paths, exposing.by, exposing.exposures)
    amounts = amounts_of(paths, exposing.by, exposing.exposures)
    return [Bracket(p.stem, (p,), (amount,)) for p, (_, amount) in zip(paths, amounts, strict=True)], []


def _grouped(
    paths: Sequence[Path], exposing: Exposing | None, bursts: str | None, decoder: Decoder | None
) -> tuple[list[Bracket], list[str]]:
    return bursts_of(paths, bursts, ImageStore(decoder)) if bursts else brackets_of_images(paths, exposing)


def _listed_source(
    spec: CaptureSpec, decoder: Decoder | None, exposing: Exposing | None, excluded: set[Path], bursts: str | None
) -> Source:
    if exposing is None and not bursts:
        capture = build_capture(spec, decoder)
        groups = [ExposureGroup(s.name, (s.image,), None, s.camera) for s in spec.observations]
        return Source(tuple(_sized(groups, capture)), capture, framing=spec.framing)
    if parts := [observation for observation in spec.observations if observation.image.part is not None]:
        raise InputError(f"{parts[0].image}: parts of one EXR have no exposures of their own; omit the option")
    listed = {observation.image.path.resolve(): n for n, observation in reversed(list(enumerate(spec.observations)))}
    paths = [observation.image.path for observation in spec.observations]
    if bursts or (exposing and exposing.merged):
        paths += _unlisted(spec, exposing, excluded | set(listed))
    brackets, warnings = _grouped(list(dict.fromkeys(paths)), exposing, bursts, decoder)
    chosen: list[tuple[int, Bracket]] = []
    for bracket in brackets:
        resolved = {path.resolve() for path in bracket.paths}
        indices = [n for n, observation in enumerate(spec.observations) if observation.image.path.resolve() in resolved]
        if indices:
            _same_light(spec, indices)
            chosen.append((indices[0], bracket))
    if len(chosen) < len(brackets):
        what = "bursts" if bursts else "brackets"
        warnings.append(f"{spec.source}: {len(brackets) - len(chosen)} {what} in its folders are not in its list")
    chosen.sort(key=lambda pair: pair[0])
    firsts = tuple(spec.observations[n] for n, _ in chosen)
    capture = build_capture(replace(spec, observations=firsts), decoder)
    groups = [
        ExposureGroup(
            s.name, tuple(replace(s.image, path=p) for p in b.paths), b.amounts if exposing else None, s.camera
        )
        for s, (_, b) in zip(firsts, chosen, strict=True)
    ]
    return Source(tuple(_sized(groups, capture)), capture, tuple(warnings), spec.framing)


def encoded_steps(source: Source) -> Generator[None, None, Source]:
    """Yield before each test image; return the source with the measured encoding of files that state none.

    A recovery of the same capture reads them in this encoding.
    """
    encoding = source.capture.encoding if source.capture else None
    if encoding is None or encoding.known_by != "guess":
        return source
    files = [image for group in source.groups for image in group.images if not is_exr(image.path)]
    if any(image.colour_space != "auto" or encoding.store.encoding(image)[1] != "guess" for image in files):
        return source  # a capture of several encodings: its flat fields could be of either
    yield from encoding.test_steps()
    warnings = (*source.warnings, message) if (message := encoding.message()) else source.warnings

    def encoded(image: ImageRef) -> ImageRef:
        return image if is_exr(image.path) else replace(image, colour_space=encoding.colour_space)

    groups = source.groups
    if encoding.colour_space != encoding.assumed:
        groups = tuple(replace(group, images=tuple(map(encoded, group.images))) for group in groups)
    return replace(source, groups=groups, warnings=warnings)


def _sized(groups: Sequence[ExposureGroup], capture: Capture) -> list[ExposureGroup]:
    return [replace(s, size=(capture.cameras[s.camera].width, capture.cameras[s.camera].height)) for s in groups]


def _unlisted(spec: CaptureSpec, exposing: Exposing | None, excluded: set[Path]) -> list[Path]:
    """Return unlisted images in the folders of a capture's images; with ``exposing``, those with an exposure."""
    masks = {view.mask.path.resolve() for view in spec.views if view.mask}
    folders = dict.fromkeys(observation.image.path.parent for observation in spec.observations)
    unlisted = [
        p for folder in folders for p in images_in(folder) if p.resolve() not in excluded | masks and not is_mask(p)
    ]
    if exposing is None:
        return unlisted
    if exposing.by == "exif":
        return [path for path in unlisted if exposure_of(read_bytes(path))]
    return [path for path in unlisted if name_amount(path.stem, exposing.exposures)]


def _same_light(spec: CaptureSpec, indices: Sequence[int]) -> None:
    first = spec.observations[indices[0]]
    a = np.asarray(first.vector) / max(np.linalg.norm(first.vector), 1e-30)
    for n in indices[1:]:
        other = spec.observations[n]
        b = np.asarray(other.vector) / max(np.linalg.norm(other.vector), 1e-30)
        if np.linalg.norm(a - b) > np.radians(_SAME_LIGHT_DEGREES) or other.camera != first.camera:
            raise InputError(
                f"{other.where}: is in one bracket with {first.where}, but their lights differ; check the order of"
                " exposures, or list one photograph per bracket"
            )
