"""Photographs of a web page, read from the capture that the result's report names."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...capture.types import Capture
from ...core.errors import InputError
from ...exports.result import Result
from ...exports.web.photographs import PHOTOGRAPHS, Photographs, photographs_of, spread
from ...geometry.build import card_bake, card_lights, domain_from_card
from ...geometry.domain import with_lights
from ...pipeline.preview import PART, smaller_capture
from .job_options import file_capture

UNNAMED = "its report does not say which part of which photographs its maps show"


def names_photographs(result: Result) -> bool:
    """Return whether the report names its maps' photographs; those of the window and of ``tile`` do not."""
    settings = result.report.get("settings")
    return "tile" not in result.report and isinstance(settings, dict) and "crop" in settings


def page_photographs(result: Result, options: Namespace) -> Photographs | None:
    """Return --photographs of a card's photographs, at most, read again with the options of its recovery.

    None for 0 of them, and by default where the report does not name them. First come those held out of the fit, then
    those whose lights are farthest apart. Raises InputError where the capture is no longer there or has changed; the
    remedy is --photographs 0.
    """
    count = PHOTOGRAPHS if options.photographs is None else options.photographs
    if count < 0:
        raise InputError(f"--photographs {count}: give a number from 0")
    if not count:
        return None
    if not names_photographs(result):
        if options.photographs is None:
            return None
        raise InputError(f"{result.folder}: {UNNAMED}; give --photographs 0")
    settings = result.report["settings"]
    if not Path(settings["capture"]).exists():
        raise InputError(
            f"{settings['capture']}: the capture of {result.folder} is no longer there; put it back, or give"
            " --photographs 0"
        )
    capture = file_capture(Namespace(**{**settings, "json": True, "quiet": True}))
    if settings.get("preview") == PART:  # the result is a preview
        capture = smaller_capture(capture)
    if card_bake(capture).coverage.shape != result.maps.solved.shape:
        raise InputError(
            f"{settings['capture']}: has other pictures than when {result.folder} was made; recover again, or give"
            " --photographs 0"
        )
    return _chosen(capture, result.report, count)


def _chosen(capture: Capture, report: Mapping[str, Any], count: int) -> Photographs:
    names = [observation.name for observation in capture.observations]
    if "held_out" in report:
        held_out = capture.numbers(report["held_out"])
    else:  # a report of an older version
        held_out = [k for k, name in enumerate(names) if name in report.get("relighting_psnr_db", ())]
    chosen = spread(card_lights(capture), card_bake(capture), held_out, count)
    domain = domain_from_card(replace(capture, observations=tuple(capture.observations[k] for k in chosen)))
    if isinstance(lights := report.get("lights"), dict):  # estimated by the recovery
        domain = with_lights(domain, np.array(lights["lights"])[chosen], np.array(lights["intensities"])[chosen])
    unseen = [index for index, k in enumerate(chosen) if k in held_out]
    return photographs_of(domain, [names[k] for k in chosen], unseen)
