"""``frames VIDEO``: photographs from a video of a lamp that is carried around a subject."""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..blender.movie import Movie, opened_movie
from ..calibration.video import FEWEST, LOOKED_AT, check_camera, chosen_frames, look_at
from ..capture.images.colour_profile import ColourProfile, ProfileError, profile_of_h273
from ..core.errors import InputError
from ..core.files import check_unused, new_folder
from ..core.png import encode_png
from ..core.progress_bar import ProgressBar
from .options.values import silent

COUNT = 40
_LOOKING = 0.8  # of the work


def run(options: Namespace) -> dict:
    """Write the chosen frames into a new folder. Raises InputError and then writes nothing."""
    count = COUNT if options.count is None else options.count
    if count < FEWEST:
        raise InputError(f"--count {count}: give {FEWEST} or more; 20 or more lights are needed for roughness")
    path, out = Path(options.video), Path(options.output)
    check_unused(out)
    bar = ProgressBar("frames", silent(options))
    with opened_movie(path) as movie:
        profile = _profile(movie)
        chosen = _chosen(movie, profile, count, lambda part: bar.show(_LOOKING * part, "looking for lights"))
        with new_folder(out) as folder:
            greys = []
            for number, index in enumerate(chosen):
                bar.show(_LOOKING + (1 - _LOOKING) * number / len(chosen), "writing")
                picture = movie.frame(index)
                greys.append(profile.linearised(picture.values).mean(axis=-1))
                encode_png(folder / f"frame_{index + 1:05d}.png", picture.values, picture.bits, movie.cicp)
            moved = check_camera(greys, str(path))
    bar.show(1.0, "done")
    bar.close()
    warnings = []
    if moved:
        warnings.append(f"{moved} of the frames are shifted; irpso develop --register can correct that")
    if len(chosen) < count:
        warnings.append(f"only {len(chosen)} of {count} frames differ in light; carry the lamp farther around")
    for warning in warnings:
        sys.stderr.write(f"irpso: {path}: {warning}\n")
    if not silent(options):
        sys.stdout.write(f"{len(chosen)} of {movie.frames} frames written to {out}; next: irpso calibrate {out}\n")
    return {"output": str(out), "frames": [index + 1 for index in chosen], "warnings": warnings}


def _chosen(movie: Movie, profile: ColourProfile, count: int, show: Callable[[float], None]) -> list[int]:
    """Return the indices of the frames to keep."""
    indices = np.unique(np.linspace(0, movie.frames - 1, min(movie.frames, LOOKED_AT)).round().astype(int)).tolist()
    looks = []
    for number, index in enumerate(indices):
        show(number / len(indices))
        looks.append(look_at(movie.frame(index).values, profile.linearised))
    return [indices[k] for k in chosen_frames(looks, count, str(movie.path))]


def _profile(movie: Movie) -> ColourProfile:
    try:
        return profile_of_h273(*movie.cicp)
    except ProfileError as error:
        raise InputError(f"{movie.path}: {error}; film without HDR, in Rec. 709") from error
