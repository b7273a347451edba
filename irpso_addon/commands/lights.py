"""What ``recover`` does about lights that are not known well."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Collection, Mapping

import numpy as np

from ..capture.steps import run_steps
from ..capture.types import Capture
from ..geometry.domain import Domain, subset
from ..maps.result import Maps
from ..reflectance.model import ReflectanceModel
from ..solver import lights
from .progress import ProgressBar, silent

_GIVEN_AS_ONE = (1.0, 1.0, 1.0)  # what a capture has that tells no intensities


def check_lights(options: Namespace) -> None:
    """Raise InputError for options that cannot be followed."""
    if _asked(options):
        lights.check(options.intensities == "estimate", options.refine_directions)


def found_lights(
    domain: Domain, kept: list[int], model: ReflectanceModel, known: Mapping[str, np.ndarray], options: Namespace
) -> lights.Lights | None:
    """Return the lights by the observations ``kept``, None where they are taken as given."""
    if not _asked(options):
        return None
    steps = lights.light_steps(
        domain, model, None, options.seed, known, intensities=options.intensities == "estimate",
        refine_degrees=options.refine_directions, fitted=kept, entry=options.entry,
    )  # fmt: skip
    bar = ProgressBar("lights", silent(options))
    try:
        return run_steps(steps, lambda part: bar.show(part, "recovering a sample of the texels under them"))
    finally:
        bar.close()


def light_warnings(
    found: lights.Lights | None,
    capture: Capture,
    domain: Domain,
    kept: list[int],
    maps: Maps,
    known: Collection[str],
    options: Namespace,
) -> list[str]:
    """Return what makes the lights doubtful: those that were found, or intensities that the capture does not tell."""
    if found is not None and options.intensities == "estimate":
        return found.warnings()
    if any(tuple(observation.light.intensity) != _GIVEN_AS_ONE for observation in capture.observations):
        return []
    text = lights.contradiction(subset(domain, kept), maps.model, maps.values, frozenset(known), options.seed)
    return [text] if text else []


def _asked(options: Namespace) -> bool:
    return options.intensities == "estimate" or options.refine_directions != 0
