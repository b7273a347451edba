"""Photographs from videos: the frames of different light, written as PNG files with the video's colours."""

from __future__ import annotations

import itertools
import zlib
from collections.abc import Generator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..calibration.video import MAX_COMPARED, MIN_FRAMES, check_camera, chosen_frames, describe_frame
from ..capture.images.colour_profile import ColourProfile, ProfileError, profile_of_h273
from ..core.errors import InputError
from ..core.files import new_folder
from ..core.png import encode_png
from .movie import Movie, opened_movie

COUNT = 40  # photographs, where no number is given
_MAX_REPEATED = 0.05  # of the frames compared: more equal the one before in all bits, and no camera is without noise
_LOOK = "look at the photographs, and copy the video again if they are broken"
_SEARCH_SHARE = 0.8  # of the work: the search for frames of different light; the rest writes


@dataclass(frozen=True)
class Frames:
    """Photographs that were written. numbers: of the frames, from 1, in the order of the files. total: of all frames.

    files: their names. warnings: lines.
    """

    files: tuple[str, ...]
    numbers: tuple[int, ...]
    total: int
    warnings: tuple[str, ...]


def frame_steps(videos: Sequence[Path], out: Path, count: int = COUNT) -> Generator[tuple[float, str], None, Frames]:
    """Yield the fraction done and what is done; write at most ``count`` frames of videos into a new folder.

    The videos show one subject by one camera on a tripod; their frames are chosen together. Raises InputError where the
    camera moves, fewer than three lights differ, or a video cannot be read, and then writes nothing.
    """
    if count < MIN_FRAMES:
        raise InputError(f"--count {count}: give {MIN_FRAMES} or more; 20 or more lights are needed for roughness")
    where = str(videos[0]) if len(videos) == 1 else f"{videos[0].parent}: {len(videos)} videos"
    with ExitStack() as stack:
        movies = [stack.enter_context(opened_movie(path)) for path in videos]
        profiles = [_profile(movie) for movie in movies]
        for other in movies[1:]:
            if other.size != movies[0].size:
                raise InputError(
                    f"{other.path}: is {other.size[0]}×{other.size[1]} pixels, {movies[0].path} {movies[0].size[0]}×"
                    f"{movies[0].size[1]}; give videos of one camera and one size"
                )
        chosen, warnings = yield from _chosen_steps(movies, profiles, count, where)
        files, greys, names, changed = [], [], _names(videos), 0
        with new_folder(out) as folder:
            for done, ((number, index), digest) in enumerate(chosen.items()):
                yield _SEARCH_SHARE + (1 - _SEARCH_SHARE) * done / len(chosen), "writing"
                movie = movies[number]
                picture = movie.frame(index)
                changed += _digest(picture.values) != digest
                greys.append(profiles[number].linearised(picture.values).mean(axis=-1))
                files.append(f"{names[number]}_{index + 1:05d}.png")
                encode_png(folder / files[-1], picture.values, picture.bits, movie.cicp)
            moved = check_camera(greys, where)
    if changed:
        warnings.append(
            f"{where}: {changed} of the photographs changed when they were read again; the video may be damaged:"
            f" {_LOOK}"
        )
    if moved:
        warnings.append(f"{where}: {moved} of the frames are shifted; irpso develop --register can correct that")
    if len(chosen) < count:
        warnings.append(f"{where}: only {len(chosen)} of {count} frames differ in light; carry the lamp farther around")
    numbers = tuple(index + 1 for _, index in chosen)
    return Frames(tuple(files), numbers, sum(movie.frames for movie in movies), tuple(warnings))


def _chosen_steps(
    movies: Sequence[Movie], profiles: Sequence[ColourProfile], count: int, where: str
) -> Generator[tuple[float, str], None, tuple[dict[tuple[int, int], int], list[str]]]:
    """Yield the progress; return the frames to keep, and warnings.

    The frames: (number of the movie, index in it) → digest of its codes.
    """
    places: list[tuple[int, int]] = []
    for number, movie in enumerate(movies):
        looked_at = min(movie.frames, max(1, MAX_COMPARED // len(movies)))
        indices = np.unique(np.linspace(0, movie.frames - 1, looked_at).round().astype(int))
        places += [(number, index) for index in indices.tolist()]
    looks, digests = [], []
    for number, index in places:
        yield _SEARCH_SHARE * len(looks) / len(places), "looking for lights"
        codes = movies[number].frame(index).values
        looks.append(describe_frame(codes, profiles[number].linearised))
        digests.append(_digest(codes))
    warnings = []
    repeated = sum(one == other for one, other in itertools.pairwise(digests))
    if repeated > _MAX_REPEATED * len(digests):
        warnings.append(
            f"{where}: {repeated} of {len(digests)} frames repeat the one before; the video may be damaged or cut"
            f" off, or its frame rate varies: {_LOOK}"
        )
    return {places[k]: digests[k] for k in chosen_frames(looks, count, where)}, warnings


def _digest(codes: np.ndarray) -> int:
    return zlib.crc32(np.ascontiguousarray(codes).data)


def _names(videos: Sequence[Path]) -> list[str]:
    """Return the first part of the frames' names: of one video "frame", of several their stems, numbered if equal."""
    if len(videos) == 1:
        return ["frame"]
    stems, names = {path.stem.lower() for path in videos}, dict[str, str]()
    for path in videos:
        numbered = (f"{path.stem}_{number}" for number in itertools.count(2))
        free = (name for name in numbered if name.lower() not in stems | names.keys())
        name = next(free) if path.stem.lower() in names else path.stem
        names[name.lower()] = name
    return list(names.values())


def _profile(movie: Movie) -> ColourProfile:
    try:
        return profile_of_h273(*movie.cicp)
    except ProfileError as error:
        raise InputError(f"{movie.path}: {error}; film without HDR, in Rec. 709") from error
