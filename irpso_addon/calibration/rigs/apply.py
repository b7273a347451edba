"""Application of a rig to photographs: a capture with the rig's lamps and cameras, developed if it has corrections."""

from __future__ import annotations

import json
from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...capture.formats.diligent import mask_of
from ...capture.formats.table import TABLE
from ...capture.framing import Framing
from ...capture.images.image import ImageRef, ImageStore
from ...capture.images.linearise import Decoder
from ...capture.spec import CaptureSpec, build_capture
from ...capture.write import table_text
from ...core.errors import InputError
from ...core.files import check_unused, natural, new_folder
from ...core.steps import map_steps
from ..developing.corrections_file import photograph_at
from ..developing.measure import Measured, Output, Progress
from ..developing.write import write_developed_steps
from ..photographs import relative_path
from ..radiometry.develop import Corrections, ExposureGroup, developed
from ..radiometry.frames import TooDark
from ..radiometry.source import Exposing, Source, read_source
from .match import check_exposures, check_photographs, distinct, file_kind, matched, rig_exposure
from .rig import Rig

_FAILED = 0.02  # of the median of brightness over intensity: below, the lamp failed
_BRIGHT = 99.0  # percentile of a photograph that is its brightness
_SAMPLED = 512  # pixels of the longer side: sampling for the brightness
_CHECKED = 0.4  # fraction of the work when all lamps are checked
_SPACE = "colour_space"


@dataclass(frozen=True)
class Applied:
    """lamps: photograph → lamp, by file names. left_out: lamps that failed, or have no photograph, with the reason.

    developed: whether images were written; else the capture refers to the photographs.
    """

    lamps: dict[str, str]
    left_out: tuple[str, ...]
    warnings: tuple[str, ...]
    developed: bool


def apply_steps(
    rig: Rig,
    photographs: Path,
    out: Path,
    way: str = "auto",
    exposure: str | None = None,
    half: bool = False,
    decoder: Decoder | None = None,
) -> Generator[Progress, None, Applied]:
    """Yield before each photograph; write a capture of photographs under a rig's lamps into a new folder.

    way: see ``matched``. exposure: "exif" scales photographs to the rig's exposure. Raises InputError, and writes
    nothing, if the photographs do not fit the rig.
    """
    check_unused(out)
    measured = _measured(rig, exposure)
    exposing = None if measured is None else measured.exposing
    space = rig.spec.observations[0].image.colour_space if measured is None else measured.colour_space
    source = read_source(photographs, decoder, exposing, space)
    kinds = {file_kind(name) for name in (source.groups[0].images[0].path.name, rig.photographs[0].file)}
    if len(kinds) > 1:  # the rig's colour space is of its own kind of file
        space = "auto"
        source = read_source(photographs, decoder, exposing, space)
    groups, warnings = source.groups, source.warnings + _framing_warning(source, photographs)
    store = ImageStore(decoder)
    names = distinct([_name(group) for group in groups], [group.name for group in groups])
    lamps = matched(rig, names, way, str(photographs))
    taken = [photograph_at(_file(group), group.images[0].path) for group in groups]
    check_photographs(rig, groups, taken, lamps, store)
    if exposing is None:
        check_exposures(rig, groups, taken, lamps)
    cameras = [rig.spec.observations[lamp].camera for lamp in lamps]
    groups = tuple(
        replace(group, camera=n, size=rig.spec.views[n].size) for group, n in zip(groups, cameras, strict=True)
    )
    measured = None if measured is None else _for_cameras(measured, len(rig.spec.views))
    corrections = Corrections(darks=(None,) * len(rig.spec.views), flats=(None,) * len(rig.spec.views))
    steps = _lit_steps(store, groups, [rig.spec.observations[lamp].intensity for lamp in lamps],
                       corrections if measured is None else measured.corrections)  # fmt: skip
    lit = yield from map_steps(steps, lambda step: Progress(_CHECKED * step.done, step.what))
    names = distinct([photograph.file for photograph in rig.photographs], [o.name for o in rig.spec.observations])
    files = _labels(groups)
    left_out = [f"{files[k]}: is black, the lamp of {names[lamps[k]]} failed" for k in np.flatnonzero(~lit)]
    left_out += [f"{name}: its lamp has no photograph" for n, name in enumerate(names) if n not in lamps]
    order = sorted(np.flatnonzero(lit), key=lambda k: natural(files[k]))
    used = [(groups[k], lamps[k]) for k in order]
    spec = _spec(rig, photographs, out, used)
    applied = Applied({files[k]: names[lamps[k]] for k in order}, tuple(left_out), warnings, measured is not None)
    report = {"rig": str(rig.path), "photographs": str(photographs), "lamps": applied.lamps, "left_out": left_out}
    if measured is None:
        _write_table(spec, out, space, report, decoder)
        return applied
    developing = Source(tuple(group for group, _ in used), build_capture(spec, decoder), warnings)
    writing = write_developed_steps(store, developing, measured, out, report, Output(half=half, corrections=False))
    written = yield from map_steps(writing, lambda step: Progress(_CHECKED + (1 - _CHECKED) * step.done, step.what))
    return replace(applied, warnings=tuple(written["warnings"]))


def _framing_warning(source: Source, photographs: Path) -> tuple[str, ...]:
    if source.framing == Framing():
        return ()
    return (f"{photographs}: its crop, corners or scale are left out; give them again with the new capture",)


def _measured(rig: Rig, exposure: str | None) -> Measured | None:
    """Return the corrections to apply, with scaling by ``exposure``, or None. Raises InputError."""
    measured = rig.measured
    if exposure is None:
        return measured
    if measured is not None and measured.exposing is not None:
        raise InputError("--exposure: the rig was developed with exposures and reads them by itself; omit it")
    if measured is not None and any(dark is not None for dark in measured.corrections.darks):
        raise InputError("--exposure exif: the rig's dark frame is of one exposure; photograph with that one")
    amount = rig_exposure(rig)
    space = rig.spec.observations[0].image.colour_space
    base = Measured(Corrections(), colour_space=space) if measured is None else measured
    return replace(base, corrections=replace(base.corrections, reference=amount), exposing=Exposing("exif", False))


def _for_cameras(measured: Measured, count: int) -> Measured:
    """Repeat the corrections of one camera for several."""
    one = measured.corrections
    return replace(measured, corrections=replace(one, darks=one.darks[:1] * count, flats=one.flats[:1] * count))


def _lit_steps(
    store: ImageStore, groups: Sequence[ExposureGroup], intensities: Sequence[Sequence[float]], corrections: Corrections
) -> Generator[Progress, None, np.ndarray]:
    """Yield before each photograph; return whether a lamp lit each (K,). Raises InputError if most are black."""
    bright = np.zeros(len(groups))
    for k, group in enumerate(groups):
        yield Progress(k / len(groups), group.name)
        try:
            rgba = developed(store, group, corrections).rgba
        except TooDark:
            continue
        step = -(-max(rgba.shape[:2]) // _SAMPLED)
        sampled = rgba[::step, ::step]
        bright[k] = np.percentile(sampled[..., :3].max(axis=-1), _BRIGHT) / np.mean(intensities[k])
    median = float(np.median(bright))
    if median <= 0:
        raise InputError(
            f"{groups[0].images[0].path.parent}: most of its photographs are black; check lamps and camera"
        )
    return bright > _FAILED * median


def _spec(rig: Rig, photographs: Path, out: Path, used: Sequence[tuple[ExposureGroup, int]]) -> CaptureSpec:
    """Return the spec of photographs under their lamps; a single camera uses the mask in their folder."""
    observations = tuple(
        replace(rig.spec.observations[lamp], name=_file(group), image=group.images[0], where=str(group.images[0].path))
        for group, lamp in used
    )
    views = list(rig.spec.views)
    folder = photographs if photographs.is_dir() else photographs.parent
    mask = mask_of(folder)
    if len(views) == 1 and mask is not None:
        views[0] = replace(views[0], mask=ImageRef(mask))
    return replace(rig.spec, name=out.name, source=photographs, observations=observations, views=tuple(views))


def _write_table(spec: CaptureSpec, out: Path, space: str, report: dict, decoder: Decoder | None) -> None:
    """Write a capture.toml that refers to the photographs, and a report, into a new folder."""
    capture = build_capture(spec, decoder)
    pictures = [_picture(observation.image, out, space) for observation in spec.observations]
    masks = {n: {"mask": relative_path(view.mask.path, out)} for n, view in enumerate(spec.views) if view.mask}
    text = table_text(capture, pictures, masks, {} if space == "auto" else {_SPACE: space})
    with new_folder(out) as folder:
        (folder / TABLE).write_text(text, encoding="utf-8")
        (folder / "report.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")


def _picture(image: ImageRef, out: Path, space: str) -> dict[str, str | int]:
    """Return an image's keys of a capture.toml in ``out`` with the colour space ``space``."""
    own = image.colour_space if image.colour_space != space else None
    keys = {"image": relative_path(image.path, out), "part": image.part, "layer": image.layer, _SPACE: own}
    return {key: value for key, value in keys.items() if value is not None}


def _file(group: ExposureGroup) -> str:
    image = group.images[0]
    inside = [f" {what} {name}" for what, name in (("part", image.part), ("layer", image.layer)) if name is not None]
    return "".join([image.path.name, *inside])


def _labels(groups: Sequence[ExposureGroup]) -> list[str]:
    """Return a name for each photograph: its file's, or, where files have equal names, with its folder."""
    return distinct([_file(group) for group in groups],
                    [f"{group.images[0].path.parent.name}/{_file(group)}" for group in groups])  # fmt: skip


def _name(group: ExposureGroup) -> str:
    """Return the name of a photograph without its suffix, or of a bracket without exposures."""
    return group.images[0].path.stem if len(group.images) == 1 else group.name
