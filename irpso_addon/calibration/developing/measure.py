"""Measurement of corrections: response curve, dark frame, flat field, then colours."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...capture.errors import CaptureError, raise_all
from ...capture.images.exif import exposure_of
from ...capture.images.exr_header import is_exr
from ...capture.images.headers import read_bytes
from ...capture.images.image import ImageRef, ImageStore
from ...capture.images.raw import is_raw
from ...capture.spec import orientation_faults
from ...core.errors import InputError
from ..charts.grey_card import find_grey_card
from ..charts.search import find_chart
from ..radiometry.brackets import exif_amount, index_amount, name_amount
from ..radiometry.colour_fit import chart_report, chart_warnings, orient_chart
from ..radiometry.curve_file import read_response
from ..radiometry.develop import Corrections, ExposureGroup, developed
from ..radiometry.frames import (
    Dark,
    Flat,
    Patch,
    mean_dark,
    mean_flat,
    patch_mean,
    read_frame,
    white_gains,
    without_dark,
)
from ..radiometry.hdr import SATURATED
from ..radiometry.response import Response
from ..radiometry.source import Exposing, Source
from .greys import AUTO, MATT_ONLY, grey_row_response, patch_response

_GOOD = 3.0  # mean ΔE2000 of a chart that ends the search; above, other photographs are searched, too


class Progress(NamedTuple):
    """The fraction of the work done, 0…1, and the name of the current step."""

    done: float
    what: str


@dataclass(frozen=True)
class Output:
    """How images are written. register: onto the image named ``reference``, or the first. half: 16-bit floats.

    corrections: write these, too, for a rig.
    """

    register: bool = False
    reference: str | None = None
    half: bool = False
    corrections: bool = True

    def __post_init__(self) -> None:
        if self.reference and not self.register:
            raise InputError("--reference is the image that --register moves the others onto; add --register")


@dataclass(frozen=True)
class SearchedCard:
    """A grey card to be searched. reflectance: sets the scale; None for white balance alone."""

    reflectance: float | None = None


@dataclass(frozen=True)
class MeasureOptions:
    """Options of the measurement. chart: photograph of the patches or the chart; None for those of the capture.

    greys: patches for the response curve, or "auto" for the grey row of the colour chart. white: a grey patch, a card
    to be searched, or three gains. colour_chart: corners (4, 2), or "auto" to search it. Other fields are options of
    ``develop``.
    """

    response: Path | None = None
    greys: tuple[Patch, ...] | str = ()
    chart: Path | None = None
    darks: tuple[Path, ...] = ()
    scale_dark: bool = False
    flats: tuple[Path, ...] = ()
    white: Patch | SearchedCard | tuple[float, float, float] | None = None
    colour_chart: np.ndarray | str | None = None
    exposing: Exposing | None = None
    saturated: float = SATURATED
    colour_space: str = "auto"
    output: Output = Output()

    def __post_init__(self) -> None:
        if self.white is not None and self.colour_chart is not None:
            raise InputError("--white and --colour-chart both give the white balance; give one of them")
        if self.response is not None and self.greys:
            raise InputError("--response and --grey-card both give the curve; give one of them")

    @property
    def left_out(self) -> list[Path]:
        """The files that do not show the subject."""
        return [*self.darks, *self.flats, *([self.chart] if self.chart else [])]


@dataclass(frozen=True)
class Measured:
    """Corrections, their figures for the report, and warnings. exposing, colour_space: how the files are read."""

    corrections: Corrections
    figures: dict = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    exposing: Exposing | None = None
    colour_space: str = "auto"


def measure_steps(store: ImageStore, source: Source, options: MeasureOptions) -> Generator[Progress, None, Measured]:
    """Yield before each measurement; return the corrections. Raises InputError if one cannot be measured."""
    work = _Work(store, source, options)
    work.check_orientations()
    work.check_sizes()
    groups = source.groups
    cameras = 1 + max(group.camera for group in groups)
    amounts = [a for group in groups for a in group.amounts or ()]
    response = yield from work.response()
    corrections = Corrections(
        response=response,
        reference=min(amounts, default=1.0),
        saturated=options.saturated,
        align_brackets=options.output.register,
    )
    dark = flat = None
    if options.darks:
        yield Progress(0.0, "dark frames")
        dark = work.dark(corrections.response)
    if options.flats:
        yield Progress(0.1, "flat fields")
        flat = work.flat(corrections.response, dark)
    corrections = replace(corrections, darks=(dark,) * cameras, flats=(flat,) * cameras)
    if options.white is not None:
        gains = yield from work.gains(corrections, options.white)
        corrections = replace(corrections, gains=gains)
    if isinstance(options.colour_chart, str):
        matrix = yield from work.searched(corrections)
        corrections = replace(corrections, matrix=matrix)
    elif options.colour_chart is not None:
        corrections = replace(corrections, matrix=work.matrix(corrections, options.colour_chart))
    return Measured(corrections, work.figures, tuple(work.warnings), options.exposing, work.colour_space)


class _Work:
    """The measurements of one source; each adds to ``figures`` and ``warnings``."""

    def __init__(self, store: ImageStore, source: Source, options: MeasureOptions):
        self.store, self.source, self.options = store, source, options
        # Of EXR files, True, and of others: a flat field of another kind than the photographs has its own.
        self.colour_spaces = _common_spaces(source, options)
        self.figures: dict = {}
        self.warnings: list[str] = []

    @property
    def colour_space(self) -> str:
        """The colour space of the photographs."""
        return self.colour_spaces[is_exr(self.source.groups[0].images[0].path)]

    def check_orientations(self) -> None:
        """Raise CaptureError for a file with another EXIF orientation than most of its camera's."""
        groups = self.source.groups
        faults: list[CaptureError] = []
        for camera in sorted({group.camera for group in groups}):
            images = [image for group in groups if group.camera == camera for image in group.images]
            if camera == groups[0].camera:
                images += map(self._ref, self.options.left_out)
            faults += orientation_faults(images, self.store)
        raise_all(faults)

    def check_sizes(self) -> None:
        """Raise InputError where one dark frame or flat field cannot serve all cameras."""
        first, *others = self.source.groups
        other = next((group for group in others if group.size != first.size), None)
        if other and (self.options.darks or self.options.flats):
            sizes = (f"{g.images[0]} is {'×'.join(map(str, g.size or ()))}" for g in (first, other))
            raise InputError(
                f"{'--dark' if self.options.darks else '--flat'}: the photographs of all cameras must have one size;"
                f" {' and '.join(sizes)}; develop those of each camera by themselves"
            )

    def response(self) -> Generator[Progress, None, Response | None]:
        if self.options.response is not None:
            response = read_response(self.options.response)
            self.figures["response"] = {"file": str(self.options.response), "residual": finite(response.residual)}
            return response
        if not self.options.greys:
            return None
        if isinstance(self.options.greys, str):
            return (yield from self._grey_row())
        image = self._middle(self._groups("")[0])
        response = patch_response(self.store, image, self.options.greys)
        patches = [f"{patch}={patch.reflectance}" for patch in self.options.greys]
        self.figures["response"] = {"chart": str(image), "patches": patches, "residual": finite(response.residual)}
        return response

    def _grey_row(self) -> Generator[Progress, None, Response]:
        """Return the curve by the colour chart's grey row, in ``chart`` or the first photograph that shows it."""
        groups = self._groups("")
        for k, group in enumerate(groups):
            yield Progress(0.1 * k / len(groups), f"grey row: {group.name}")
            image = self._middle(group)
            if (response := grey_row_response(self.store, image)) is not None:
                self.figures["response"] = {"chart": str(image), "patches": AUTO, "residual": finite(response.residual)}
                self.warnings.append(f"--grey-card {AUTO}: {image}: {MATT_ONLY}")
                return response
        raise InputError(
            f"--grey-card auto: no 24-patch chart, whose grey row gives the curve, is found in {_many(groups)};"
            " photograph it whole, larger and evenly lit, or give grey patches as X,Y,W,H=REFLECTANCE"
        )

    def dark(self, response: Response | None) -> Dark:
        files, size = self.options.darks, self.source.groups[0].size
        amounts = [self._amount(p) for p in files]
        self._check_known(files, amounts)
        frames = ((amount, read_frame(self.store, self._ref(p), response, size).rgb)
                  for p, amount in zip(files, amounts, strict=True))  # fmt: skip
        dark = mean_dark(frames, self.options.scale_dark)
        self.figures["dark"] = {"files": [str(p) for p in files],
                                "mean": [round(float(level.mean()), 7) for _, level in dark.levels]}  # fmt: skip
        return dark

    def flat(self, response: Response | None, dark: Dark | None) -> Flat:
        files, size = self.options.flats, self.source.groups[0].size
        read = ((p, read_frame(self.store, self._ref(p), response, size)) for p in files)
        if dark is not None:
            read = ((p, without_dark(frame, dark.of(self._amount(p), str(p)), str(p))) for p, frame in read)
        flat = mean_flat(frame for _, frame in read)
        low, high = np.quantile(flat.field[flat.usable], (0.001, 0.999))
        self.figures["flat"] = {"files": [str(p) for p in files],
                                "range": [round(float(low), 4), round(float(high), 4)],
                                "not_usable": round(float(1 - flat.usable.mean()), 6)}  # fmt: skip
        if not flat.usable.all():
            self.warnings.append(
                f"{files[0]}: the flat field is clipped or too dark at {1 - flat.usable.mean():.1%} of the pixels,"
                " which get weight 0"
            )
        return flat

    def gains(
        self, corrections: Corrections, white: Patch | SearchedCard | tuple[float, float, float]
    ) -> Generator[Progress, None, tuple[float, float, float]]:
        """Return the gains of a white balance: as given, or measured on a patch or on the grey card."""
        group = self.source.groups[0]
        if isinstance(white, Patch):
            group = self._chart_group(white.reflectance is not None, "omit =…")
        elif isinstance(white, SearchedCard):
            group, white = yield from self._searched_card(corrections, white.reflectance)
        if isinstance(white, Patch):
            rgba = developed(self.store, group, corrections).rgba
            where = f"--white {white}: {group.images[0]}"
            gains = white_gains(patch_mean(rgba[..., :3], rgba[..., 3], white, where), white.reflectance, where)
        else:
            gains = np.array(white)
        self.figures["white_gains"] = [round(float(g), 6) for g in gains]
        red, green, blue = (float(g) for g in gains)
        return red, green, blue

    def _searched_card(
        self, corrections: Corrections, reflectance: float | None
    ) -> Generator[Progress, None, tuple[ExposureGroup, Patch]]:
        """Search the grey card in ``chart``, or else in the groups; return the first that shows it, and a patch."""
        groups = self._groups("omit =…" if reflectance is not None else "")
        for k, group in enumerate(groups):
            yield Progress(0.2 * k / len(groups), f"grey card: {group.name}")
            where = f"--white {AUTO}: {group.images[0]}"
            card = find_grey_card(developed(self.store, group, corrections).rgba, where)
            if card is not None:
                self.figures["grey_card"] = {"file": str(group.images[0]), "patch": str(card)}
                return group, replace(card, reflectance=reflectance)
        raise InputError(
            f"--white {AUTO}: no grey card, an even and neutral rectangle, is found in {_many(groups)}; set the"
            " camera's white balance near the lamp's, let nothing cover the card, or give its place as X,Y,W,H"
        )

    def matrix(self, corrections: Corrections, corners: np.ndarray) -> np.ndarray:
        """Return the colour matrix by a chart at given corners; it includes white balance and scale."""
        group = self._chart_group(True, "give one that has it, as the other photographs do")
        where = f"--colour-chart: {group.images[0]}"
        order, chart, fit = orient_chart(developed(self.store, group, corrections).rgba, corners, where)
        self.figures["colour_chart"] = {"file": str(group.images[0]), **chart_report(order, chart, fit)}
        self.warnings += chart_warnings(where, corners, order, chart, fit)
        return fit.matrix

    def searched(self, corrections: Corrections) -> Generator[Progress, None, np.ndarray]:
        """Search the colour chart in ``chart``, or else in the groups; return the colour matrix of the best fit."""
        groups = self._groups("give one that has it")
        best = None
        for k, group in enumerate(groups):
            yield Progress(0.2 * k / len(groups), f"colour chart: {group.name}")
            where = f"--colour-chart: {group.images[0]}"
            found = find_chart(developed(self.store, group, corrections).rgba, where)
            if found is None:
                continue
            mean = float(np.nanmean(found.fit.after))
            if best is None or mean < best[0]:
                best = mean, where, group, found
            if mean <= _GOOD:
                break
        if best is None:
            raise InputError(
                f"--colour-chart auto: no 24-patch chart is found in {_many(groups)}; photograph it whole, larger and"
                " evenly lit, or give its corners as X1,Y1,…,X4,Y4"
            )
        _, where, group, found = best
        report = chart_report(found.corners, found.chart, found.fit)
        self.figures["colour_chart"] = {"file": str(group.images[0]), "found": True, **report}
        self.warnings += chart_warnings(where, found.corners, found.corners, found.chart, found.fit)
        return found.fit.matrix

    def _groups(self, remedy: str) -> list[ExposureGroup]:
        """Return ``chart`` as a group, or all groups. remedy: in the error if ``chart`` lacks a needed exposure."""
        return [self._chart_group(bool(remedy), remedy)] if self.options.chart else list(self.source.groups)

    @staticmethod
    def _middle(group: ExposureGroup) -> ImageRef:
        return group.images[len(group.images) // 2]

    def _ref(self, path: Path) -> ImageRef:
        return ImageRef(path, colour_space=self.colour_spaces[is_exr(path)])

    def _amount(self, path: Path) -> float | None:
        """Return the exposure of a file that is not a group; None if it has none or exposures are not used."""
        exposing = self.options.exposing
        if exposing is None:
            return None
        if exposing.by == "exif":
            return exif_amount(path) if exposure_of(read_bytes(path)) else None
        if exposing.exposures:
            shown = [image.path for group in self.source.groups for image in group.images]
            return index_amount(path, shown, exposing.exposures)
        parsed = name_amount(path.stem)
        return parsed[1] if parsed else None

    def _check_known(self, darks: Sequence[Path], amounts: Sequence[float | None]) -> None:
        """Raise InputError for one of several dark frames whose name does not tell which of the --exposures it has."""
        exposing = self.options.exposing
        if exposing is None or len(set(exposing.exposures)) < 2 or len(darks) < 2 or None not in amounts:
            return
        raise InputError(
            f"{darks[amounts.index(None)]}: its name does not tell which of the --exposures it has; end it with that"
            " one's number, as the photographs' names"
        )

    def _chart_group(self, scaled: bool, remedy: str) -> ExposureGroup:
        first, chart = self.source.groups[0], self.options.chart
        if chart is None:
            return first
        shows = (g for g in self.source.groups if chart.resolve() in [image.path.resolve() for image in g.images])
        own = next(shows, first)
        amount = self._amount(chart)
        if scaled and self.options.exposing is not None and amount is None:
            raise InputError(f"{chart}: has no exposure, so the card gives no scale; {remedy}")
        amounts = None if amount is None else (amount,)
        return ExposureGroup("chart", (self._ref(chart),), amounts, own.camera, own.size)


def _common_spaces(source: Source, options: MeasureOptions) -> dict[bool, str]:
    """Return the colour spaces of a capture's EXR images, True, and of its others; "auto" where it has none."""
    images = [image for group in source.groups for image in group.images if not is_raw(image.path)]
    of_kind: dict[bool, list[ImageRef]] = {True: [], False: []}
    for image in images:
        of_kind[is_exr(image.path)].append(image)
    return {exr: _common_space(own, options) if own else "auto" for exr, own in of_kind.items()}


def _common_space(images: Sequence[ImageRef], options: MeasureOptions) -> str:
    """Return the colour space of images: as set, or as stated; "auto" if they state several.

    An error if they state several and other files are to be read in it.
    """
    if options.colour_space != "auto":
        return options.colour_space
    first, *others = images
    if other := next((image for image in others if image.colour_space != first.colour_space), None):
        if not options.left_out:
            return "auto"
        raise InputError(
            f'{other}: has colour_space "{other.colour_space}" where {first} has "{first.colour_space}"; develop'
            " photographs of one encoding, or set --colour-space (Color Space)"
        )
    return first.colour_space


def _many(groups: list[ExposureGroup]) -> str:
    return f"any of the {len(groups)} photographs" if len(groups) > 1 else str(groups[0].images[0])


def finite(value: float) -> float | None:
    """Return a number for a report: rounded to 6 decimals, None if it is not finite."""
    return round(value, 6) if np.isfinite(value) else None
