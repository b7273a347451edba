"""Atomic output of developed photographs: a capture's images and lists, the corrections, and a report."""

from __future__ import annotations

import json
import shutil
from collections.abc import Generator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...capture.images.exr import write_exr
from ...capture.images.image import ImageStore
from ...capture.write import write_steps
from ...core.errors import InputError
from ...core.files import check_unused, new_folder
from ...core.steps import map_steps
from ..radiometry.develop import developed, registration_steps
from ..radiometry.source import Source, encoded_steps
from ..register import MIN_MOVE, moved_back
from .corrections_file import FOLDER, photograph_of, write_corrections
from .measure import Measured, MeasureOptions, Output, Progress, finite, measure_steps

_FILENAMES = "filenames.txt"
_MEASURED, _REGISTERED = 0.2, 0.5  # fraction of the work at the end of each step


def develop_steps(
    store: ImageStore, source: Source, options: MeasureOptions, out: Path, settings: dict[str, Any]
) -> Generator[Progress, None, dict]:
    """Measure the corrections of a source, develop its photographs into a new folder, and return the report.

    settings: for the report. Writes nothing if it raises InputError.
    """
    check_unused(out)
    if options.response is None and not options.greys:  # a response curve decodes the files in place of an encoding
        source = yield from map_steps(encoded_steps(source), lambda _: Progress(0.0, "testing the encoding"))
    measured = yield from measure_steps(store, source, options)
    return (yield from write_developed_steps(store, source, measured, out, settings, options.output))


def write_developed_steps(
    store: ImageStore, source: Source, measured: Measured, out: Path, settings: dict[str, Any], output: Output
) -> Generator[Progress, None, dict]:
    """Develop a source with known corrections into a new folder, and return the report.

    Writes nothing if it raises InputError.
    """
    work = _Work(store, source, measured, output.half)
    if output.register:
        yield from work.register_steps(output.reference)
    with new_folder(out) as folder:
        yield from work.write_steps(folder)
        if output.corrections:
            taken = [photograph_of(name, group) for name, group in zip(work.names, source.groups, strict=True)]
            write_corrections(folder / FOLDER, measured, taken)
        report = work.report(settings)
        (folder / "report.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    return report


class _Work:
    """Development of one source: reads, corrects, registers and writes each image."""

    def __init__(self, store: ImageStore, source: Source, measured: Measured, half: bool):
        self.store, self.source, self.measured, self.half = store, source, measured, half
        self.shifts: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        self.warnings = [*source.warnings, *measured.warnings]
        self.figures: list[dict] = [{} for _ in source.groups]
        self.names: list[str] = []

    def register_steps(self, reference: str | None) -> Generator[Progress, None, None]:
        """Yield the progress; measure each image's shift from the image named ``reference``, or from the first."""
        groups, capture = self.source.groups, self.source.capture
        names = [group.name for group in groups]
        if reference and reference not in names:
            raise InputError(f"--reference {reference}: there is no such image; give a name, as {names[0]}")
        masks = capture.masks if capture else [np.ones((groups[0].size or (1, 1))[::-1], bool)]
        number = names.index(reference) if reference else 0
        steps = registration_steps(self.store, groups, masks, self.measured.corrections, number)
        span = _REGISTERED - _MEASURED
        self.shifts = yield from map_steps(steps, lambda part: Progress(_MEASURED + span * part, "looking for shifts"))
        trusted = self.shifts[2]
        if not trusted.any():
            self.warnings.append(
                "the images do not agree well enough to be registered (no texture, a shiny subject, or deep shadows),"
                " so none is moved"
            )
            return
        for k in np.flatnonzero(~trusted):
            self.warnings.append(
                f"{names[k]}: agrees with no other image, so it is not moved; check if it belongs here"
            )

    def write_steps(self, folder: Path) -> Generator[Progress, None, None]:
        """Yield before each image; write all images and the lists into a folder."""
        start = _MEASURED if self.shifts is None else _REGISTERED
        groups, capture = self.source.groups, self.source.capture
        turns = [self.store.turn(group.images[0]) for group in groups]
        if capture is not None:
            observations = [replace(o, read=partial(self._read, k)) for k, o in enumerate(capture.observations)]
            developed_capture = replace(capture, observations=tuple(observations))
            framing = self.source.framing
            steps = write_steps(developed_capture, folder, half=self.half, framing=framing, turns=turns)
            self.names = yield from map_steps(steps, lambda part: Progress(start + (1 - start) * part, "developing"))
            return
        for k, group in enumerate(groups):
            yield Progress(start + (1 - start) * k / len(groups), group.name)
            rgba = self._read(k)
            channels = {name: rgba[..., i] for i, name in enumerate("RGB")}
            if (rgba[..., 3] != 1).any():
                channels["A"] = rgba[..., 3]
            self.names.append(f"{group.name}.exr")
            write_exr(folder / self.names[-1], {"": channels}, self.half, turns[k])
        listed = "".join(f"{name}\n" for name in self.names)
        (folder / _FILENAMES).write_text(listed, encoding="utf-8")
        for path in self.source.copied:
            shutil.copyfile(path, folder / path.name)

    def _read(self, index: int) -> np.ndarray:
        """Return one image to write, (H, W, 4), and store its figures."""
        groups = self.source.groups
        image = developed(self.store, groups[index], self.measured.corrections)
        rgba, figures = image.rgba, {"name": groups[index].name, **image.figures}
        if self.shifts is not None:
            (right, up), agreement, trusted = (values[index] for values in self.shifts)
            moved = bool(max(abs(right), abs(up)) >= MIN_MOVE)
            figures |= {"shift": [round(float(right), 4), round(float(up), 4)], "agreement": finite(float(agreement)),
                        "trusted": bool(trusted), "moved": moved}  # fmt: skip
            if moved:
                rgba = moved_back(rgba, right, up)
                rgba[..., :3] = np.maximum(rgba[..., :3], 0)  # Lanczos rings below 0 beside highlights
        self.figures[index] = figures
        return rgba

    def report(self, settings: dict[str, Any]) -> dict:
        """Return the report: settings, corrections and figures of each image."""
        return {"settings": settings, **self.measured.figures,
                "reference_exposure": self.measured.corrections.reference, "images": self.figures,
                "warnings": self.warnings}  # fmt: skip
