"""``develop CAPTURE``: linear images of photographs, one per light, with the capture's lists."""

from __future__ import annotations

import json
import sys
from argparse import Namespace
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from ..blender.images import decode
from ..calibration.radiometry.brackets import exif_amount, name_amount
from ..calibration.radiometry.colour_fit import chart_report, chart_warnings, recognised
from ..calibration.radiometry.curve_file import read_response
from ..calibration.radiometry.develop import Corrections, Shot, developed, registration_steps
from ..calibration.radiometry.frames import mean_dark, mean_flat, patch_mean, read_frame, white_gains, without_dark
from ..calibration.radiometry.source import Exposing, Source, read_source
from ..calibration.register import SMALLEST_MOVE, moved_back
from ..capture.images.exif import exposure_of
from ..capture.images.exr import write_exr
from ..capture.images.headers import read_bytes
from ..capture.images.image import ImageRef, ImageStore
from ..capture.write import write_capture
from ..core.errors import InputError
from ..core.files import check_unused, new_folder
from ..core.progress_bar import ProgressBar
from ..core.steps import run_steps
from .options.photographs import chart_response, corners_option, exposure_list, files_option, number_list, patch_option
from .options.values import silent

_FILENAMES = "filenames.txt"


def run(options: Namespace) -> dict:
    """Develop all photographs into a new folder. Raises InputError and then writes nothing."""
    out = Path(options.output)
    check_unused(out)
    if options.white and options.colour_chart:
        raise InputError("--white and --colour-chart both give the white balance; give one of them")
    exposing = _exposing(options)
    darks, flats = files_option("--dark", options.dark), files_option("--flat", options.flat)
    chart = Path(options.chart) if options.chart else None
    left_out = [*darks, *flats, *([chart] if chart else [])]
    source = read_source(options.capture, decode, exposing, options.colour_space, left_out)
    work = _Work(options, source, exposing, chart)
    work.prepare(darks, flats)
    work.register()
    with new_folder(out) as folder:
        work.write(folder)
        report = work.report()
        (folder / "report.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    work.bar.close()
    for warning in report["warnings"]:
        sys.stderr.write(f"irpso: {warning}\n")
    summary = {
        key: report[key] for key in ("images", "warnings", "white_gains", "colour_chart", "shifts") if key in report
    }
    if "colour_chart" in summary and not silent(options):
        sys.stdout.write(_colours(summary["colour_chart"]["delta_e_2000"]))
    return {"output": options.output, **summary, "images": len(source.shots)}


def _exposing(options: Namespace) -> Exposing | None:
    if options.brackets and options.exposure:
        raise InputError("--brackets merges what --exposure would scale frame by frame; give one of them")
    given = exposure_list("--exposures", options.exposures)
    by = options.brackets or options.exposure
    if given and by != "names":
        raise InputError("--exposures lists what the numbers at the end of names stand for; add --brackets names")
    return Exposing(by, bool(options.brackets), given) if by else None


class _Work:
    """Develops one source: measures the corrections, then reads, corrects, moves and writes each image."""

    def __init__(self, options: Namespace, source: Source, exposing: Exposing | None, chart: Path | None):
        self.options, self.source, self.exposing, self.chart = options, source, exposing, chart
        self.store = ImageStore(decode)
        self.bar = ProgressBar("develop", silent(options))
        self.shifts: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        self.warnings, self.figures = list(source.warnings), [{} for _ in source.shots]
        self.measured: dict = {}
        amounts = [a for shot in source.shots for a in shot.amounts or ()]
        self.corrections = Corrections(
            reference=min(amounts, default=1.0), saturated=options.saturated, align_brackets=options.register
        )

    def prepare(self, darks: list[Path], flats: list[Path]) -> None:
        """Find the response curve, the dark frame, the flat field and the colours, in this order."""
        shots, space = self.source.shots, self.options.colour_space
        cameras = 1 + max(shot.camera for shot in shots)
        response = self._response()
        size = shots[0].size
        dark = flat = None
        if darks:
            frames = ((self._amount(p), read_frame(self.store, ImageRef(p, colour_space=space), response, size).rgb)
                      for p in darks)  # fmt: skip
            dark = mean_dark(frames, self.options.scale_dark)
            self.measured["dark"] = {"files": [str(p) for p in darks],
                                     "mean": [round(float(level.mean()), 7) for _, level in dark.levels]}  # fmt: skip
        if flats:
            read = ((p, read_frame(self.store, ImageRef(p, colour_space=space), response, size)) for p in flats)
            if dark is not None:
                read = ((p, without_dark(frame, dark.of(self._amount(p), str(p)), str(p))) for p, frame in read)
            flat = mean_flat(frame for _, frame in read)
            low, high = np.quantile(flat.field[flat.usable], (0.001, 0.999))
            self.measured["flat"] = {"files": [str(p) for p in flats],
                                     "range": [round(float(low), 4), round(float(high), 4)],
                                     "not_usable": round(float(1 - flat.usable.mean()), 6)}  # fmt: skip
            if not flat.usable.all():
                self.warnings.append(
                    f"{flats[0]}: the flat field is clipped or too dark at {1 - flat.usable.mean():.1%} of the pixels,"
                    " which get weight 0"
                )
        self.corrections = replace(
            self.corrections, response=response, darks=(dark,) * cameras, flats=(flat,) * cameras
        )
        self.corrections = replace(self.corrections, gains=self._gains())
        self.corrections = replace(self.corrections, matrix=self._matrix())

    def _response(self):
        if self.options.response and self.options.grey_card:
            raise InputError("--response and --grey-card both give the curve; give one of them")
        if self.options.response:
            response = read_response(self.options.response)
            self.measured["response"] = {"file": self.options.response, "residual": _finite(response.residual)}
            return response
        if not self.options.grey_card:
            return None
        shot = self.source.shots[0]
        image = ImageRef(self.chart) if self.chart else shot.images[len(shot.images) // 2]
        response = chart_response(self.store, image, self.options.grey_card)
        self.measured["response"] = {"chart": str(image), "patches": self.options.grey_card,
                                     "residual": _finite(response.residual)}  # fmt: skip
        return response

    def _amount(self, path: Path) -> float | None:
        """Return the exposure of a file beside the shots; None if it has none or exposures are not used."""
        if self.exposing is None:
            return None
        if self.exposing.by == "exif":
            return exif_amount(path) if exposure_of(read_bytes(path)) else None
        found = None if self.exposing.given else name_amount(path.stem)
        return found[1] if found else None

    def _gains(self) -> tuple[float, float, float]:
        """Return the factors of --white: as given, or measured on a patch."""
        text = self.options.white
        if not text:
            return (1.0, 1.0, 1.0)
        if text.count(",") == 2:
            gains = np.array(number_list("--white", text))
            if not (np.isfinite(gains).all() and (gains > 0).all()):
                raise InputError(f"--white {text}: gains are above 0, as in --white 1.9,1,1.4")
        else:
            patch = patch_option("--white", text)
            shot = self._chart_shot(patch.reflectance is not None, "omit =…")
            rgba = developed(self.store, shot, self.corrections).rgba
            where = f"--white {text}: {shot.images[0]}"
            gains = white_gains(patch_mean(rgba[..., :3], rgba[..., 3], patch, where), patch.reflectance, where)
        self.measured["white_gains"] = [round(float(g), 6) for g in gains]
        return tuple(float(g) for g in gains)

    def _matrix(self) -> np.ndarray | None:
        """Return the matrix of --colour-chart, which includes white balance and scale; None without one."""
        if not self.options.colour_chart:
            return None
        corners = corners_option("--colour-chart", self.options.colour_chart)
        shot = self._chart_shot(True, "give one that has it, as the other photographs do")
        where = f"--colour-chart: {shot.images[0]}"
        order, chart, fit = recognised(developed(self.store, shot, self.corrections).rgba, corners, where)
        self.measured["colour_chart"] = {"file": str(shot.images[0]), **chart_report(order, chart, fit)}
        self.warnings += chart_warnings(where, corners, order, chart, fit)
        return fit.matrix

    def _chart_shot(self, scaled: bool, remedy: str) -> Shot:
        first = self.source.shots[0]
        if self.chart is None:
            return first
        amount = self._amount(self.chart)
        if scaled and self.exposing is not None and amount is None:
            raise InputError(f"{self.chart}: has no exposure, so the card gives no scale; {remedy}")
        amounts = None if amount is None else (amount,)
        image = ImageRef(self.chart, colour_space=self.options.colour_space)
        return Shot("chart", (image,), amounts, first.camera, first.size)

    def register(self) -> None:
        """Measure each image's shift against the reference, if --register is given."""
        if not self.options.register:
            if self.options.reference:
                raise InputError("--reference is the image that --register moves the others onto; add --register")
            return
        shots = self.source.shots
        names = [shot.name for shot in shots]
        wanted = self.options.reference
        if wanted and wanted not in names:
            raise InputError(f"--reference {wanted}: there is no such image; give a name, as {names[0]}")
        capture = self.source.capture
        masks = capture.masks if capture else [np.ones(shots[0].size[::-1], bool)]
        steps = registration_steps(self.store, shots, masks, self.corrections, names.index(wanted) if wanted else 0)
        self.shifts = run_steps(steps, lambda part: self.bar.show(0.5 * part, "looking for shifts"))
        if not self.shifts[2].any():
            self.warnings.append(
                f"{self.options.capture}: its images do not agree well enough to be registered (no texture, a shiny"
                " subject, or deep shadows), so none is moved"
            )
            return
        for k in np.flatnonzero(~self.shifts[2]):
            self.warnings.append(
                f"{names[k]}: agrees with no other image, so it is not moved; check if it belongs here"
            )

    def _read(self, index: int) -> np.ndarray:
        """Return one image to write, (H, W, 4), and store its figures."""
        shots = self.source.shots
        found = developed(self.store, shots[index], self.corrections)
        rgba, figures = found.rgba, {"name": shots[index].name, **found.figures}
        if self.shifts is not None:
            (right, up), agreement, trusted = (part[index] for part in self.shifts)
            moved = bool(max(abs(right), abs(up)) >= SMALLEST_MOVE)
            figures |= {"shift": [round(float(right), 4), round(float(up), 4)], "agreement": _finite(float(agreement)),
                        "trusted": bool(trusted), "moved": moved}  # fmt: skip
            if moved:
                rgba = moved_back(rgba, right, up)
                rgba[..., :3] = np.maximum(rgba[..., :3], 0)  # Lanczos rings below 0 beside highlights
        self.figures[index] = figures
        done = (index + 1) / len(shots)
        self.bar.show(0.5 + 0.5 * done if self.shifts is not None else done, shots[index].name)
        return rgba

    def write(self, folder: Path) -> None:
        """Write all images and the lists into a folder."""
        capture, half = self.source.capture, self.options.half
        if capture is not None:
            observations = [replace(o, read=partial(self._read, k)) for k, o in enumerate(capture.observations)]
            write_capture(replace(capture, observations=tuple(observations)), folder, half=half)
            return
        names = []
        for k, shot in enumerate(self.source.shots):
            rgba = self._read(k)
            channels = {name: rgba[..., i] for i, name in enumerate("RGB")}
            if (rgba[..., 3] != 1).any():
                channels["A"] = rgba[..., 3]
            names.append(f"{shot.name}.exr")
            write_exr(folder / names[-1], {"": channels}, half)
        (folder / _FILENAMES).write_text("".join(f"{name}\n" for name in names), encoding="utf-8")

    def report(self) -> dict:
        """Return the report: settings, corrections and figures of each image."""
        settings = {k: v for k, v in vars(self.options).items() if k not in ("command", "json", "quiet") and v}
        return {"settings": settings, **self.measured, "reference_exposure": self.corrections.reference,
                "images": self.figures, "warnings": self.warnings}  # fmt: skip


def _colours(found: dict) -> str:
    before, after = found["before"], found["after"]
    means, largest = (f"{before[key]:.1f} → {after[key]:.1f}" for key in ("mean", "largest"))
    return f"colour chart: ΔE2000 mean {means}, largest {largest}\n"


def _finite(value: float) -> float | None:
    return round(value, 6) if np.isfinite(value) else None
