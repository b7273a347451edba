"""A preview of a large recovery: the same job at a quarter of its size, in about a sixteenth of its time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..capture.framing import Framing, framed
from ..capture.types import Capture
from .job import Job

PART = 4  # divides both sides of the domain


def can_be_smaller(job: Job) -> bool:
    """Return whether no fixed map has texels, which fix the size."""
    return not any(np.ndim(value) > 1 for value in job.fixed.values())


def smaller(job: Job) -> Job:
    """Return the job with both sides of its domain divided by PART, without ground truth and checkpoint."""
    reduced = replace(job, truth=None, resumed=None, source=None)
    if job.mesh is not None:
        width, height = (-(-side // PART) for side in job.size)
        return replace(reduced, size=(width, height))
    capture = smaller_capture(job.capture)
    height, width = capture.masks[0].shape
    return replace(reduced, capture=capture, size=(width, height))


def smaller_capture(capture: Capture) -> Capture:
    """Return the capture that the preview of a card is recovered from."""
    return framed(capture, Framing(scale=1 / PART))
