"""What is in a capture and what is wrong with it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import TypeVar, cast

import numpy as np

from ...core.steps import map_steps, run_steps
from .. import places
from ..errors import CaptureError
from ..images.encoding import Encoding
from ..images.image import ImageStore
from ..images.linearise import Decoder, Samples
from ..noise import images_read, noise_of
from ..read import read_spec
from ..spec import CaptureSpec, ImageReader, build_steps, written_lights
from ..types import Capture
from . import checks, sufficiency
from .damage import sound_steps

_T = TypeVar("_T")
_THUMBNAIL, _CROP = 256, 512  # pixels: the longest side of what is kept of a frame
_LEAST = 16  # pixels: the shortest side that is kept, of images of that many
_COMPARED = 64  # pixels: the longest side at which frames are compared with each other, pair by pair
_MEMORY = 96 << 20  # bytes for all crops together, and for all thumbnails; checks need about twice that again
_FLAT = 0.05  # flatness: a noise of 1 % becomes one of about 20 % across the plane
_IDENTICAL, _SIMILAR = 0.0, 0.002  # relative RMS; frames of lights 2° apart differ by more than 1 %
_CLIPPED = 0.02  # of the masked pixels of all frames
_MIRRORED, _TURNED = -0.1, -0.1  # agreement and outwardness below which an axis counts as mirrored
_ENOUGH = 500  # squares or border texels that make either a finding


@dataclass(frozen=True)
class Finding:
    """Something wrong: "error" where a recovery cannot use the capture, else "warning"; with the remedy in words.

    goal: which of sufficiency.GOALS it is an obstacle to, "" for whatever is recovered.
    """

    severity: str
    code: str
    message: str
    goal: str = ""


@dataclass(frozen=True)
class Report:
    """What inspect found. facts: (what, how much) in reading order."""

    path: Path
    facts: tuple[tuple[str, str], ...]
    findings: tuple[Finding, ...]

    @property
    def usable(self) -> bool:
        """Whether no finding is an error."""
        return all(finding.severity != "error" for finding in self.findings)

    @property
    def codes(self) -> set[str]:
        """The codes of all findings."""
        return {finding.code for finding in self.findings}

    def lines(self) -> Iterator[str]:
        """Yield the report as lines of text."""
        yield str(self.path)
        yield from (f"  {what:<12} {value}" for what, value in self.facts)
        yield from (f"  {finding.severity}: {finding.message}" for finding in self.findings)
        if not self.findings:
            yield "  nothing suspicious"


@dataclass
class _Frames:
    """What is kept of the frames of one camera: thumbnails and crops of grey radiance, and counts over its mask.

    factors: by how much rows and columns of thumbnails are reduced.
    """

    mask: np.ndarray
    factors: tuple[int, int]
    window: tuple[slice, slice]
    names: list[str]
    indices: list[int]
    thumbnails: list[np.ndarray]
    crops: list[np.ndarray]
    clipped: list[float]


def inspect_capture(
    path: Path | str,
    decoder: Decoder | None = None,
    colour_space: str = "auto",
    goals: Sequence[str] = ("normals",),
    card_distance: float | None = None,
    skip_damaged: bool = False,
) -> Report:
    """Look a capture over, frame by frame, without raising for what is wrong with it; see read_capture.

    goals: of sufficiency.GOALS, what is to be recovered: lights that were measured to be too few or too narrow for it
    are warned of. What else they suffice for is among the facts. card_distance: goes before the capture's own.
    skip_damaged: as for read_capture.
    At most about 600 MB are held (300 frames of 1600×1200: 590 MB), whatever the number and size of the frames.
    """
    return run_steps(inspect_steps(path, decoder, colour_space, goals, card_distance, skip_damaged))


def inspect_steps(
    path: Path | str,
    decoder: Decoder | None = None,
    colour_space: str = "auto",
    goals: Sequence[str] = ("normals",),
    card_distance: float | None = None,
    skip_damaged: bool = False,
) -> Generator[str, None, Report]:
    """Yield, before each piece of the work, what it is, in words, and return what ``inspect_capture`` does."""
    path = Path(path)
    try:
        spec = read_spec(path, colour_space)
        if skip_damaged:
            steps = sound_steps(spec, ImageStore(decoder))
            spec = yield from _told("Looking for damaged images", len(spec.observations), steps)
    except CaptureError as error:
        return Report(path, (), _errors(error))
    spec = replace(spec, card_distance=card_distance or spec.card_distance)
    left_out = f", {len(spec.left_out)} more left out" if spec.left_out else ""
    facts = [("kind", spec.kind), ("images", f"{len(spec.observations)}{left_out}")]
    findings = [Finding("warning", "left_out", f"left out: {one.why}") for one in spec.left_out]
    lacks = {goal: _lacks(spec, goal) for goal in sufficiency.GOALS}
    findings += _light_findings(spec)
    if all(finding.severity != "error" for finding in findings):  # which says it already
        findings += [Finding("warning", f"lights_{s.code}", f"{spec.source}: {s.message}", goal)
                     for goal in goals for s in lacks[goal]]  # fmt: skip
    facts.append(("enough for", _enough_for(lacks)))
    try:
        capture = yield from _told("Looking at headers", len(spec.observations), build_steps(spec, decoder))
    except CaptureError as error:
        return Report(path, tuple(facts), (*_errors(error), *findings))
    facts += _facts(spec, capture)
    if capture.encoding is not None:
        yield from _told("Testing the encoding", 0, capture.encoding.testing())
        facts.append(("encoding", _encoding(capture.encoding)))
        if message := capture.encoding.message():
            findings.append(Finding("warning", "encoding", message))
    noise = yield from _told("Estimating the noise", images_read(capture), noise_of(capture))
    if noise:
        facts.append(("noise", f"{255 * noise:.1f} codes of 255"))
    groups = {camera: _frames_of(capture, camera) for camera in range(len(capture.cameras))}
    for index, observation in enumerate(capture.observations):
        yield f"Checking images: {index + 1} of {len(capture.observations)}"
        try:
            found = cast(ImageReader, observation.read).samples()
        except CaptureError as error:
            findings += _errors(error)
            continue
        findings += _keep(groups[observation.camera], index, str(spec.observations[index].image), found)
    for camera, frames in groups.items():
        if frames.names:
            facts.append((f"brightness{f', camera {camera + 1}' * (len(groups) > 1)}", _brightness(frames)))
            findings += yield from _told("Comparing images", 0, _frame_steps(frames))
            findings += _geometry_findings(spec, capture, camera, frames)
    findings += _place_findings(spec, capture, groups[0])
    return Report(path, tuple(facts), tuple(findings))


def _told(what: str, total: int, steps: Generator[None, None, _T]) -> Generator[str, None, _T]:
    """Yield ``what`` with a count, up to ``total`` where that is not 0, for each step, and return what they return."""
    numbers = count(1)
    return (yield from map_steps(steps, lambda _: f"{what}: {min(next(numbers), total)} of {total}" if total else what))


def _errors(error: CaptureError) -> tuple[Finding, ...]:
    return tuple(Finding("error", fault.code, fault.message) for fault in error.all)


def _facts(spec: CaptureSpec, capture: Capture) -> list[tuple[str, str]]:
    formats = Counter(shot.image.path.suffix.lower().lstrip(".") for shot in spec.observations)
    lights = [observation.light for observation in capture.observations]
    kinds = (
        (sum(light.distant for light in lights), "distant"),
        (sum(not light.distant for light in lights), "near"),
        (sum(light.cone is not None for light in lights), "with a cone"),
        (sum(light.cosine for light in lights), "falling with the cosine"),
    )
    facts = [
        ("formats", ", ".join(f"{count} {name}" for name, count in formats.items())),
        ("lights", ", ".join(f"{count} {kind}" for count, kind in kinds if count or kind in ("distant", "near"))),
    ]
    for view, camera, mask in zip(spec.views, capture.cameras, capture.masks, strict=True):
        kind = "perspective" if camera.perspective else "orthographic"
        kind += " with lens distortion" if any(camera.distortion) else ""
        masked = f"mask keeps {mask.sum()} ({mask.mean():.1%})" if view.mask else "no mask"
        facts.append((view.name, f"{camera.width}×{camera.height} {kind}, {masked}"))
    if capture.card_distance is not None and len(capture.cameras) == 1:
        width, height = places.card_size(capture.cameras[0], capture.card_distance)
        facts.append(("card", f"{capture.card_distance:g} from its camera, {width:.4g} × {height:.4g}"))
    return facts


def _encoding(encoding: Encoding) -> str:
    """Return what the images are read as, and why."""
    why = {"file": "stated", "format": "by format", "depth": "by 16 bits", "guess": "not stated"}[encoding.known_by]
    falls = [fall and f"{fall.exponent:.2f}" for fall in (encoding.test.linear, encoding.test.srgb)]
    found = f"; fall-off {falls[0]} if linear, {falls[1]} if sRGB" if all(falls) else ""
    return f"read as {'linear' if encoding.colour_space == 'linear' else 'sRGB'} ({why}){found}"


def _light_findings(spec: CaptureSpec) -> Iterator[Finding]:
    vectors = np.array([shot.vector for shot in spec.observations if shot.distant], float).reshape(-1, 3)
    wheres = [shot.where for shot in spec.observations if shot.distant]
    lights = written_lights(spec)
    lack = sufficiency.no_normal(lights) if lights else None
    if lack is not None:
        yield Finding("error", f"lights_{lack.code}", f"{spec.source}: {lack.message}", "normals")
    if len(vectors) < 3 or not np.isfinite(vectors).all() or not vectors.any(axis=1).all():
        return
    odd = checks.not_unit(vectors)
    directions = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    if odd.any():
        yield Finding(
            "warning",
            "lights_not_unit",
            f"{wheres[odd.argmax()]}: {_count(odd.sum(), 'direction is', 'directions are')} not of unit length; they"
            " are used as directions, so check that they are no positions",
        )
    flat = checks.flatness(directions)
    if flat < _FLAT and lack is None:
        yield Finding(
            "warning",
            "lights_coplanar",
            f"{spec.source}: all lights lie nearly in one plane through the subject ({flat:.3f}); across it normals"
            " are uncertain: add lights off that plane",
            "normals",
        )
    cameras = [shot.camera for shot in spec.observations if shot.distant]
    # Cameras around a subject photograph it under the same lights.
    twice = [(i, j) for i, j in checks.same_lights(directions) if cameras[i] == cameras[j]]
    for i, j in twice[:3]:
        yield Finding("warning", "lights_same", f"{wheres[j]}: the same light as {wheres[i]}; check the list's order")


def _lacks(spec: CaptureSpec, goal: str) -> list[sufficiency.Shortfall]:
    """Return what the lights lack for ``goal``: all, where one of them is none."""
    lights = written_lights(spec)
    if not lights:
        return [sufficiency.Shortfall("unreadable", "one of the lights is none")]
    if lack := sufficiency.no_normal(lights):
        return [lack]
    distant = np.array([light.distant for light in lights])
    vectors = np.array([light.vector for light in lights])
    on_card = spec.card_distance is not None and len(spec.views) == 1 and not spec.views[0].placed
    if on_card:  # near lights as its middle sees them
        vectors[~distant] += (0.0, 0.0, spec.card_distance)
    told = on_card or distant.all()
    if told and not vectors.any(axis=1).all():
        return []
    directions = vectors / np.linalg.norm(vectors, axis=1, keepdims=True) if told else None
    return list(sufficiency.shortfalls(goal, len(lights), directions))


def _enough_for(lacks: dict[str, list[sufficiency.Shortfall]]) -> str:
    good = [goal for goal, found in lacks.items() if not found]
    bad = [f"{goal} ({', '.join(s.code for s in found)})" for goal, found in lacks.items() if found]
    return "; ".join([*([", ".join(good)] if good else []), *([f"not for {', '.join(bad)}"] if bad else [])])


def _frames_of(capture: Capture, index: int) -> _Frames:
    camera, mask = capture.cameras[index], capture.masks[index]
    count = max(1, sum(observation.camera == index for observation in capture.observations))
    affordable = max(16, int((_MEMORY / len(capture.cameras) / count / 4) ** 0.5))
    factors = _factors((camera.height, camera.width), min(_THUMBNAIL, affordable))
    return _Frames(mask, factors, checks.middle_window(mask, min(_CROP, affordable)), [], [], [], [], [])


def _keep(frames: _Frames, index: int, name: str, found: Samples) -> Iterator[Finding]:
    """Keep what later checks need of one frame, and yield what is wrong with it by itself."""
    grey = found.rgba[..., :3].mean(axis=-1)
    kept = frames.mask
    frames.names.append(name)
    frames.indices.append(index)
    frames.thumbnails.append(_shrunk(grey, frames.factors))
    frames.crops.append(grey[frames.window].copy())
    frames.clipped.append(float(found.clipped[kept].mean()))
    bad, negative = int(found.not_finite[kept].sum()), int(found.negative[kept].sum())
    if bad:
        message = f"{name}: {_count(bad, 'pixel is', 'pixels are')} not a number; they get weight 0, render it again"
        yield Finding("warning", "not_finite", message)
    if negative:
        message = f"{name}: {_count(negative, 'pixel is', 'pixels are')} negative; check how it was exported"
        yield Finding("warning", "negative", message)
    if not (grey[kept] > 0).any():
        yield Finding("warning", "image_black", f"{name}: is all black; take it and its light out of the list")


def _factors(shape: tuple[int, ...], longest: int) -> tuple[int, int]:
    """Return what reduces (rows, columns) to sides of ``longest`` pixels at most, both alike but for narrow strips."""
    factor = -(-max(shape) // longest)
    rows, columns = (min(factor, max(1, side // _LEAST)) for side in shape)
    return rows, columns


def _shrunk(image: np.ndarray, factors: tuple[int, int]) -> np.ndarray:
    """Return an image reduced by whole factors by averaging; rows and columns that are left over are dropped."""
    rows, columns = (side // factor for side, factor in zip(image.shape, factors, strict=True))
    down, across = factors
    return image[: rows * down, : columns * across].reshape(rows, down, columns, across).mean(axis=(1, 3))


def _brightness(frames: _Frames) -> str:
    means = [float(thumbnail.mean()) for thumbnail in frames.thumbnails]
    return f"frame means {min(means):.4g} to {max(means):.4g}, {np.mean(frames.clipped):.2%} clipped"


def _frame_steps(frames: _Frames) -> Generator[None, None, list[Finding]]:
    """Return what comparing the frames of one camera finds."""
    shifts = yield from checks.shift_steps(np.stack(frames.crops))
    if max(frames.factors) > 1:
        coarse = yield from checks.shift_steps(np.stack(frames.thumbnails))
        coarse *= frames.factors[::-1]
        shifts = np.where(np.abs(coarse).max(axis=1, keepdims=True) > np.abs(shifts).max(axis=1, keepdims=True),
                          coarse, shifts)  # fmt: skip
    yield
    return list(_frame_findings(frames, shifts))


def _frame_findings(frames: _Frames, shifts: np.ndarray) -> Iterator[Finding]:
    names = frames.names
    if np.mean(frames.clipped) > _CLIPPED:
        worst = int(np.argmax(frames.clipped))
        yield Finding(
            "warning",
            "clipped",
            f"{names[worst]}: {frames.clipped[worst]:.1%} of its pixels are clipped and get weight 0"
            f" ({np.mean(frames.clipped):.1%} of all images'); expose shorter",
        )
    thumbnails = np.stack(frames.thumbnails)
    small = [_shrunk(thumbnail, _factors(thumbnail.shape, _COMPARED)) for thumbnail in thumbnails]
    for i, j, difference in checks.similar_frames(np.stack(small), _SIMILAR)[:5]:
        code, word = ("image_same", "is") if difference <= _IDENTICAL else ("image_similar", "is nearly")
        message = f"{names[j]}: {word} the same image as {names[i]} (difference {difference:.2%})"
        yield Finding("warning", code, message + "; check for a frame copied twice")
    moved = np.flatnonzero(shifts.any(axis=1))
    for k in moved[:5]:
        yield Finding(
            "warning",
            "shifted",
            f"{names[k]}: is shifted by {shifts[k][0]:+d} px right, {shifts[k][1]:+d} px up against the others"
            f" ({_count(len(moved), 'frame is', 'frames are')}); align the frames",
        )


def _geometry_findings(spec: CaptureSpec, capture: Capture, index: int, frames: _Frames) -> Iterator[Finding]:
    """Yield whether the lights' axes look mirrored against the images, seen from one camera."""
    observations = [capture.observations[i] for i in frames.indices]
    on_card = capture.card_distance is not None and len(capture.cameras) == 1
    if len(observations) < 3 or not (on_card or all(observation.light.distant for observation in observations)):
        return
    part = replace(capture, observations=tuple(observations), cameras=(capture.cameras[index],))
    directions, power = places.at_card(part)
    where = spec.observations[frames.indices[0]].where
    if (directions[:, 2] < 0).mean() > 0.5:
        message = (
            f"{where}: most lights are behind the subject; directions must point toward the light, z to the camera"
        )
        if not places.near_lights(capture):  # of which places.card_problems tells
            yield Finding("warning", "lights_reversed", message)
        return
    if checks.flatness(directions) < sufficiency.FLAT_USELESS:
        return
    mask = _shrunk(frames.mask.astype(float), frames.factors) > 0.999
    normals = checks.lambertian_normals(np.stack(frames.thumbnails) / power[:, None, None], directions)
    agreement, count = checks.mirror_agreement(normals, mask)
    out_x, out_y, border = checks.outwardness(normals, mask)
    if count >= _ENOUGH and agreement < _MIRRORED:
        axis = "x" if border >= _ENOUGH / 5 and out_x < out_y else "y"
        yield Finding(
            "warning",
            "mirrored",
            f"{where}: lights and images disagree as if {axis} were mirrored; if relief looks inside out, negate {axis}"
            f" of all lights, or flip the images {'left to right' if axis == 'x' else 'upside down'} (y is up)",
        )
    elif border >= _ENOUGH / 5 and out_x < _TURNED and out_y < _TURNED:
        message = f"{where}: normals point inward all along the mask; negate x and y of all lights if it is no hollow"
        yield Finding("warning", "turned", message)


def _place_findings(spec: CaptureSpec, capture: Capture, frames: _Frames) -> Iterator[Finding]:
    """Yield what speaks for lengths in different units. frames: of the first camera."""
    for view, camera in zip(spec.views, capture.cameras, strict=True):
        for code, message in places.lens_problems(camera):
            yield Finding("warning", code, f"{view.where}: {message}")
    if not places.near_lights(capture):
        return
    for view in spec.views:
        if not view.lens:
            message = "is taken as 2 units wide, in which places of lights are counted; give fov_degrees or world_width"
            yield Finding("warning", "lens", f"{view.where}: {message}")
    found: list[places.Problem] = []
    if len(capture.cameras) > 1:
        found += places.camera_problems(capture) if all(camera.perspective for camera in capture.cameras) else ()
    elif capture.card_distance is not None:
        found += [*places.card_problems(capture), *places.strength_problems(capture, _brightest(frames, capture))]
    elif not spec.views[0].placed:
        message = "near lights on a flat card need its distance from the camera, in the unit of their places; add"
        found.append(("card_distance", f"{message} card_distance = … (of a mesh nothing is missing)"))
    yield from (Finding("warning", code, f"{spec.source}: {message}") for code, message in found)


def _brightest(frames: _Frames, capture: Capture) -> np.ndarray:
    """Return (K,) a bright radiance, the 99th percentile, of each observation in its mask; NaN of unreadable ones."""
    bright = np.full(len(capture.observations), np.nan)
    mask = _shrunk(frames.mask.astype(float), frames.factors) > 0.5
    if mask.any():
        bright[frames.indices] = [np.percentile(thumbnail[mask], 99) for thumbnail in frames.thumbnails]
    return bright


def _count(number: int, one: str, many: str) -> str:
    return f"{number} {one if number == 1 else many}"
