"""``Job``: one recovery with all its settings, for command line, MPI and window."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..blender.materials.anisotropy_nodes import grain_parameters
from ..capture.types import Capture
from ..core.errors import InputError
from ..geometry.surface.mesh import MeshData
from ..gpu.kernel import EntryChoice
from ..reflectance.model import ReflectanceModel
from ..solver.lights.refine import Intensities
from ..solver.settings.schedule import Schedule
from ..solver.views.held_out import order_of


@dataclass(frozen=True)
class LightOptions:
    """The estimate of lights. degrees: assumed standard deviation of the directions' errors; 0 keeps directions."""

    intensities: Intensities = "auto"
    degrees: float = 0.0


def possible_schedule(schedule: Schedule, shadowed_mesh: bool) -> Schedule:
    """Return a schedule without the matte rounds that are not possible. shadowed_mesh: with predicted shadows."""
    return schedule if shadowed_mesh and schedule.levels == 1 else schedule.without_matte_rounds()


@dataclass(frozen=True, kw_only=True)
class Job:
    """One recovery and all its settings, checked.

    capture: the held-out observations come last. name: of material and images. mesh: None for a card. object_uid:
    Blender's session number of the mesh object. size: (width, height) of the domain. fixed: parameter name → its map,
    normals in Blender's tangent frame; truth: the same of a ground truth. held_out: the numbers, from 0, of the
    observations that are not fitted, in the order of their files or scene. scratch: the folder for scratch files.
    skip_damaged: damaged images have been left out. resumed: the checkpoint to continue from. source: all that the
    sample stack depends on, None if unknown; equal sources have equal domains. warnings: of the checks.
    """

    capture: Capture
    name: str
    model: ReflectanceModel
    schedule: Schedule
    seed: int
    size: tuple[int, int]
    scratch: Path
    mesh: MeshData | None = None
    object_uid: int | None = None
    fixed: Mapping[str, np.ndarray] = field(default_factory=dict)
    truth: Mapping[str, np.ndarray] | None = None
    held_out: tuple[int, ...] = ()
    lights: LightOptions = LightOptions()
    shadows: bool = True
    skip_damaged: bool = False
    entry: EntryChoice = "auto"
    memory: str | None = None
    resumed: Path | None = None
    source: tuple[Any, ...] | None = None
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "schedule", self.possible(self.schedule))
        _check_beams(self)
        _check_grain(self)

    def possible(self, schedule: Schedule) -> Schedule:
        """Return a schedule as the job runs it: matte rounds need a mesh that casts shadows, solved at one size."""
        return possible_schedule(schedule, self.mesh is not None and self.shadows)

    @property
    def fitted(self) -> range:
        """The indices of the capture's observations that are fitted."""
        return range(len(self.capture.observations) - len(self.held_out))

    @property
    def held_out_indices(self) -> range:
        """The indices of the held-out observations."""
        return range(len(self.fitted), len(self.capture.observations))

    @property
    def numbers(self) -> list[int]:
        """The number, from 0, of each of the capture's observations in its files or scene."""
        return order_of(len(self.capture.observations), self.held_out)

    @property
    def listed_numbers(self) -> list[int]:
        """The number, from 0, of each of the capture's observations among those that its files list."""
        listed = self.capture.listed_numbers
        return [listed[number] for number in self.numbers]

    def fitted_at(self, number: int) -> int:
        """Return the index of the observation with a listed number, from 0, or of the next fitted one."""
        numbers = self.listed_numbers[: len(self.fitted)]
        return min(bisect_left(numbers, number), len(numbers) - 1)


def _check_beams(job: Job) -> None:
    """Raise InputError where a refined lamp would keep the beam of its former place."""
    beam = next((observation for observation in job.capture.observations if observation.light.cosine), None)
    if job.lights.degrees and beam is not None:
        raise InputError(
            f"--refine-directions (Refine Lights): the light of '{beam.name}' falls off from its axis"
            " (light_cosine), which is not corrected with its place; set it to 0, or leave light_cosine out"
        )


def _check_grain(job: Job) -> None:
    """Raise InputError where one of a grain's two numbers is given alone on a mesh, between whose frames they mix."""
    pair = set(grain_parameters(job.model) or ())
    for option, maps in (("--fixed", job.fixed), ("--ground-truth", job.truth or {})):
        if job.mesh is not None and len(alone := pair & set(maps)) == 1:
            raise InputError(
                f"{option}: {alone.pop()} is one of the two numbers of a grain, which mix between the frames of a"
                f" mesh; give both, {' and '.join(sorted(pair))}, or neither"
            )
