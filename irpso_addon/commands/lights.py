"""What ``recover`` does about lights that are not known well."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Collection, Mapping

import numpy as np

from ..capture.types import Capture
from ..core.steps import run_steps
from ..geometry.domain import Domain, subset
from ..reflectance.model import ReflectanceModel
from ..results.maps import Maps
from ..solver.lights import refine as lights
from .progress import ProgressBar, silent

_GIVEN_AS_ONE = (1.0, 1.0, 1.0)  # what a capture has that tells no intensities


def check_lights(options: Namespace) -> None:
    """Raise InputError for options that cannot be followed."""
    lights.check(True, options.refine_directions)


def found_lights(
    domain: Domain, kept: list[int], model: ReflectanceModel, fixed: Mapping[str, np.ndarray], options: Namespace
) -> lights.Lights | None:
    """Return the lights by the observations ``kept``, None where they are taken as given."""
    steps = lights.chosen_steps(
        domain, model, options.seed, fixed, intensities=options.intensities,
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
    fixed: Collection[str],
    options: Namespace,
) -> list[str]:
    """Return what makes the lights doubtful: those that were found, or intensities that the capture does not tell."""
    if found is not None and (found.factors != 1).any():
        return found.warnings(options.intensities == "estimate")
    if any(tuple(observation.light.intensity) != _GIVEN_AS_ONE for observation in capture.observations):
        return []
    text = lights.contradiction(subset(domain, kept), maps.model, maps.values, frozenset(fixed), options.seed)
    return [text] if text else []
