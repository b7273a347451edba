"""Inspects a capture: facts about its contents, and findings of its faults."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import TypeVar, cast

import numpy as np

from ...core.steps import blocking, map_steps
from ..card import card_size, lights_at_card, near_lights
from ..errors import CaptureError
from ..frame.find import DetectedCorners
from ..framing import AUTO, axis_cosine, found_corner_steps, framed, used_pixels
from ..images.encoding import Encoding
from ..images.image import ImageStore
from ..images.linearise import Decoder
from ..light_geometry import flatness
from ..noise import images_read, noise_of
from ..read import read_spec
from ..spec import CaptureSpec, ImageReader, build_steps, written_lights
from ..types import Capture
from . import checks, shading, sufficiency, units
from .damage import without_damaged_steps
from .frames import Finding, Frames, add_frame, brightest, brightness, counted, frame_steps, frames_of, shrunk
from .light_order import light_order_message
from .room_light import room_light, room_light_message

_T = TypeVar("_T")
_FLAT = 0.05  # flatness: a noise of 1 % becomes about 20 % perpendicular to the plane
_MIRRORED, _TURNED = -0.1, -0.1  # of ``mirror_agreement`` and ``outward_components``: below, an axis is mirrored
_ENOUGH = 500  # fewest squares, or border texels, for either finding


@dataclass(frozen=True)
class Report:
    """Result of inspect. facts: (name, value) in reading order. images: number of usable ones.

    texels: number of the first camera's mask, after framing. corners: of a card, for a framing with corners "auto".
    """

    path: Path
    facts: tuple[tuple[str, str], ...]
    findings: tuple[Finding, ...]
    images: int = 0
    texels: int = 0
    corners: DetectedCorners | None = None

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


def inspect_steps(
    path: Path | str,
    decoder: Decoder | None = None,
    colour_space: str = "auto",
    goals: Sequence[str] = ("normals",),
    card_distance: float | None = None,
    skip_damaged: bool = False,
    card_width: float | None = None,
    change: Callable[[CaptureSpec], CaptureSpec] | None = None,
) -> Generator[str, None, Report]:
    """Check a capture, frame by frame; its faults become findings instead of errors. Yields a line before each step.

    path, decoder, colour_space, skip_damaged: as of read_capture. goals: of sufficiency.GOALS, the purpose of the
    recovery: findings warn if the lights are too few or too narrow for it; the facts list all goals. card_distance,
    card_width: override the capture's own. change: of the capture's framing and card, before those. Memory: at most
    about 600 MB (300 frames of 1600×1200: 590 MB), whatever the number and size of the frames.
    """
    path = Path(path)
    try:
        spec = yield from _spec_steps(path, decoder, colour_space, skip_damaged, change)
    except CaptureError as error:
        return Report(path, (), _errors(error))
    framing = replace(spec.framing, card_width=None if card_distance else card_width or spec.framing.card_width)
    spec = replace(spec, card_distance=card_distance or spec.card_distance, framing=framing)
    left_out = f", {len(spec.left_out)} more left out" if spec.left_out else ""
    facts = [("kind", spec.kind), ("images", f"{len(spec.observations)}{left_out}")]
    findings = [Finding("left_out", f"left out: {one.why}") for one in spec.left_out]
    shortfalls = {goal: _shortfalls(spec, goal) for goal in sufficiency.GOALS}
    findings += _light_findings(spec)
    if all(finding.severity != "error" for finding in findings):  # errors say it already
        findings += [Finding(f"lights_{s.code}", f"{spec.source}: {s.message}", goal)
                     for goal in goals for s in shortfalls[goal]]  # fmt: skip
    facts.append(("enough for", _enough_for(shortfalls)))
    try:
        capture = yield from _numbered("Looking at headers", len(spec.observations), build_steps(spec, decoder))
    except CaptureError as error:
        return Report(path, tuple(facts), (*_errors(error), *findings))
    findings += [Finding("exposure", text) for text in capture.warnings]
    texels, corners = 0, None
    try:
        if framing.corners == AUTO:
            search = found_corner_steps(capture, framing)
            framing, corners = yield from map_steps(search, lambda done: f"Looking for corners: {done:.0%}")
        part = framed(capture, framing)
        texels = int(np.count_nonzero(part.masks[0]))
        if part.card_distance is not None:
            cosine = axis_cosine(capture.cameras[0], part.cameras[0])
            capture = replace(capture, card_distance=part.card_distance / cosine)
        findings += [Finding("card_tilted", f"{spec.source}: {text}") for text in part.card_warnings]
        facts += _facts(spec, capture, part)
        if framing.crop or framing.corners:
            used = (used_pixels(camera, framing) for camera in capture.cameras)
            capture = replace(capture, masks=tuple(map(np.logical_and, capture.masks, used)))
    except CaptureError as error:
        findings += _errors(error)
    yield from _encoding_steps(capture, facts, findings)
    noise = yield from _numbered("Estimating the noise", images_read(capture), noise_of(capture))
    if noise:
        facts.append(("noise", f"{255 * noise:.1f} codes of 255"))
    yield from _image_steps(spec, capture, bool(framing.crop or framing.corners), facts, findings)
    return Report(path, tuple(facts), tuple(findings), len(capture.observations), texels, corners)


inspect_capture = blocking("inspect_capture", inspect_steps)


def _spec_steps(
    path: Path,
    decoder: Decoder | None,
    colour_space: str,
    skip_damaged: bool,
    change: Callable[[CaptureSpec], CaptureSpec] | None,
) -> Generator[str, None, CaptureSpec]:
    """Yield a line before each image that is checked for damage; return the changed specification."""
    spec = read_spec(path, colour_space)
    spec = spec if change is None else change(spec)
    if not skip_damaged:
        return spec
    steps = without_damaged_steps(spec, ImageStore(decoder))
    return (yield from _numbered("Looking for damaged images", len(spec.observations), steps))


def _encoding_steps(
    capture: Capture, facts: list[tuple[str, str]], findings: list[Finding]
) -> Generator[str, None, None]:
    """Append the fact and the finding of the images' encoding; yield a line before each step."""
    if capture.encoding is None:
        return
    yield from _numbered("Testing the encoding", 0, capture.encoding.test_steps())
    facts.append(("encoding", _encoding(capture.encoding)))
    if message := capture.encoding.message():
        findings.append(Finding("encoding", message))


def _image_steps(
    spec: CaptureSpec, capture: Capture, part: bool, facts: list[tuple[str, str]], findings: list[Finding]
) -> Generator[str, None, None]:
    """Append the facts and findings of the images; yield a line before each step. part: as of ``frames_of``."""
    groups = {camera: frames_of(capture, camera, part) for camera in range(len(capture.cameras))}
    for index, observation in enumerate(capture.observations):
        yield f"Checking images: {index + 1} of {len(capture.observations)}"
        try:
            samples = cast(ImageReader, observation.read).samples()
        except CaptureError as error:
            findings += _errors(error)
            continue
        findings += add_frame(groups[observation.camera], index, str(spec.observations[index].image), samples)
    for camera, frames in groups.items():
        if frames.names:
            facts.append((f"brightness{f', {spec.views[camera].name}' * (len(groups) > 1)}", brightness(frames)))
            intensities = _intensities(capture, camera, frames)
            findings += yield from _numbered("Comparing images", 0, frame_steps(frames, intensities))
            pixels = _some_pixels(frames)
            findings += _geometry_findings(spec, capture, camera, frames, pixels)
            findings += _room_light_findings(capture, frames, pixels)
    findings += _place_findings(spec, capture, groups[0])


def _intensities(capture: Capture, camera: int, frames: Frames) -> np.ndarray:
    """Return (N,) the mean intensities of the frames' lights; NaN of distant ones behind the subject."""
    lights = [capture.observations[index].light for index in frames.indices]
    behind = [light.distant and np.dot(light.vector, capture.cameras[camera].backward) <= 0 for light in lights]
    return np.where(behind, np.nan, [np.mean(light.intensity) for light in lights])


def _room_light_findings(capture: Capture, frames: Frames, pixels: np.ndarray) -> Iterator[Finding]:
    """Yield a finding of room light, under distant lights only: near ones need the pixels' positions."""
    lights = [capture.observations[index].light for index in frames.indices]
    if len(lights) < sufficiency.MIN_LIGHTS or not all(light.distant for light in lights):
        return
    lamps = np.array([np.multiply(light.vector, np.mean(light.intensity)) for light in lights])
    if text := room_light_message(room_light(pixels, pixels > 0, lamps[:, None])):
        yield Finding("room_light", text)


def _some_pixels(frames: Frames) -> np.ndarray:
    """Return (K, T) samples of randomly chosen pixels inside the mask."""
    values = np.stack(frames.thumbnails)[:, shrunk(frames.mask.astype(float), frames.factors) > 0.99]
    return values[:, np.random.default_rng(0).permutation(values.shape[1])[: shading.PIXELS]]


def _numbered(what: str, total: int, steps: Generator[None, None, _T]) -> Generator[str, None, _T]:
    """Yield ``what`` for each step, with a count up to ``total`` unless it is 0; return the result of the steps."""
    numbers = count(1)
    return (yield from map_steps(steps, lambda _: f"{what}: {min(next(numbers), total)} of {total}" if total else what))


def _errors(error: CaptureError) -> tuple[Finding, ...]:
    return tuple(Finding(fault.code, fault.message, severity="error") for fault in error.all)


def _facts(spec: CaptureSpec, capture: Capture, part: Capture) -> list[tuple[str, str]]:
    formats = Counter(observation.image.path.suffix.lower().lstrip(".") for observation in spec.observations)
    lights = capture.lights
    kinds = (
        (sum(light.distant for light in lights), "distant"),
        (sum(not light.distant for light in lights), "near"),
        (sum(light.cone is not None for light in lights), "with a cone"),
        (sum(light.cosine > 0 for light in lights), "falling with the cosine"),
    )
    facts = [
        ("formats", ", ".join(f"{count} {name}" for name, count in formats.items())),
        ("lights", ", ".join(f"{count} {kind}" for count, kind in kinds if count or kind in ("distant", "near"))),
    ]
    readers = [cast(ImageReader, observation.read) for observation in capture.observations]
    profiles = Counter(profile.name for reader in readers if (profile := reader.store.profile(reader.image)))
    if profiles:
        named = ", ".join(f"{count} {name}" for name, count in profiles.items())
        facts.append(("colours", f"{named}, converted to Rec. 709"))
    for view, camera, mask, used in zip(spec.views, capture.cameras, capture.masks, part.cameras, strict=True):
        kind = "perspective" if camera.perspective else "orthographic"
        kind += " with lens distortion" if any(camera.distortion) else ""
        masked = f"mask keeps {mask.sum()} ({mask.mean():.1%})" if view.mask else "no mask"
        facts.append((view.name, f"{camera.width}×{camera.height} {kind}, {masked}"))
        if used is not camera:
            facts.append(("used", f"{used.width}×{used.height} of that"))
    if part.card_distance is not None and len(part.cameras) == 1:
        width, height = card_size(part.cameras[0], part.card_distance)
        facts.append(("card", f"{part.card_distance:g} from its camera, {width:.4g} × {height:.4g}"))
    return facts


def _encoding(encoding: Encoding) -> str:
    """Return the encoding of the images and its reason, as text."""
    why = {"file": "stated", "format": "by format", "depth": "by 16 bits", "guess": "not stated"}[encoding.known_by]
    falls = [fall and f"{fall.exponent:.2f}" for fall in (encoding.test.linear, encoding.test.srgb)]
    found = f"; fall-off {falls[0]} if linear, {falls[1]} if sRGB" if all(falls) else ""
    return f"read as {'linear' if encoding.colour_space == 'linear' else 'sRGB'} ({why}){found}"


def _light_findings(spec: CaptureSpec) -> Iterator[Finding]:
    distant = [observation for observation in spec.observations if observation.distant]
    vectors = np.array([observation.vector for observation in distant], float).reshape(-1, 3)
    wheres = [observation.where for observation in distant]
    lights = written_lights(spec)
    lack = sufficiency.no_normal(lights) if lights else None
    if lack is not None:
        yield Finding(f"lights_{lack.code}", f"{spec.source}: {lack.message}", "normals", "error")
    if len(vectors) < 3 or not lights:
        return
    odd = checks.not_unit(vectors)
    directions = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    if odd.any():
        yield Finding(
            "lights_not_unit",
            f"{wheres[odd.argmax()]}: {counted(odd.sum(), 'direction is', 'directions are')} not of unit length; they"
            " are used as directions: if they are positions of lamps, give them as light_position in a capture.toml",
        )
    flat = flatness(directions)
    if flat < _FLAT and lack is None:
        yield Finding(
            "lights_coplanar",
            f"{spec.source}: all lights lie nearly in one plane through the subject ({flat:.3f}); across it normals"
            " are uncertain: add lights off that plane",
            "normals",
        )
    cameras = [observation.camera for observation in distant]
    # Several cameras may photograph the subject under the same lights.
    twice = [(i, j) for i, j in checks.same_lights(directions) if cameras[i] == cameras[j]]
    for i, j in twice[:3]:
        yield Finding("lights_same", f"{wheres[j]}: the same light as {wheres[i]}; check the list's order")


def _shortfalls(spec: CaptureSpec, goal: str) -> list[sufficiency.Shortfall]:
    """Return the shortfalls of the lights for ``goal``."""
    lights = written_lights(spec)
    if not lights:
        return [sufficiency.Shortfall("unreadable", "one of the lights has invalid numbers")]
    if lack := sufficiency.no_normal(lights):
        return [lack]
    distant = np.array([light.distant for light in lights])
    vectors = np.array([light.vector for light in lights])
    on_card = spec.card_distance is not None and len(spec.views) == 1 and not spec.views[0].placed
    if on_card:  # near lights relative to the card's middle
        vectors[~distant] += (0.0, 0.0, spec.card_distance)
    known = on_card or distant.all()
    if known and not vectors.any(axis=1).all():
        return []
    directions = vectors / np.linalg.norm(vectors, axis=1, keepdims=True) if known else None
    return list(sufficiency.shortfalls(goal, len(lights), directions))


def _enough_for(shortfalls: dict[str, list[sufficiency.Shortfall]]) -> str:
    met = [goal for goal, lacking in shortfalls.items() if not lacking]
    unmet = [f"{goal} ({', '.join(s.code for s in lacking)})" for goal, lacking in shortfalls.items() if lacking]
    return "; ".join([*([", ".join(met)] if met else []), *([f"not for {', '.join(unmet)}"] if unmet else [])])


def _geometry_findings(
    spec: CaptureSpec, capture: Capture, index: int, frames: Frames, pixels: np.ndarray
) -> Iterator[Finding]:
    """Yield findings of lights whose axes are mirrored, or whose order differs, relative to one camera's images."""
    observations = [capture.observations[i] for i in frames.indices]
    on_card = capture.card_distance is not None and len(capture.cameras) == 1
    if len(observations) < 3 or not (on_card or all(observation.light.distant for observation in observations)):
        return
    part = replace(capture, observations=tuple(observations), cameras=(capture.cameras[index],))
    directions, power = lights_at_card(part)
    where = spec.observations[frames.indices[0]].where
    if (directions[:, 2] < 0).mean() > 0.5:
        message = (
            f"{where}: most lights are behind the subject; directions must point toward the light, z to the camera"
        )
        if not near_lights(capture):  # else units.card_problems reports them
            yield Finding("lights_reversed", message)
        return
    if flatness(directions) < sufficiency.FLAT_USELESS:
        return
    names = [observation.name for observation in observations]
    if text := light_order_message(pixels, pixels > 0, (directions * power[:, None])[:, None], names):
        yield Finding("lights_order", f"{spec.source}: {text}")
    mask = shrunk(frames.mask.astype(float), frames.factors) > 0.999
    normals = checks.lambertian_normals(np.stack(frames.thumbnails) / power[:, None, None], directions)
    agreement, count = checks.mirror_agreement(normals, mask)
    out_x, out_y, border = checks.outward_components(normals, mask)
    if count >= _ENOUGH and agreement < _MIRRORED:
        axis = "x" if border >= _ENOUGH / 5 and out_x < out_y else "y"
        yield Finding(
            "mirrored",
            f"{where}: lights and images disagree as if {axis} were mirrored; if relief looks inside out, negate {axis}"
            f" of all lights, or flip the images {'left to right' if axis == 'x' else 'upside down'} (y is up)",
        )
    elif border >= _ENOUGH / 5 and out_x < _TURNED and out_y < _TURNED:
        message = "by its shading the subject is a hollow; if it bulges outward, negate x and y of all lights"
        yield Finding("turned", f"{where}: {message}")


def _place_findings(spec: CaptureSpec, capture: Capture, frames: Frames) -> Iterator[Finding]:
    """Yield findings of lengths in different units. frames: of the first camera."""
    for view, camera in zip(spec.views, capture.cameras, strict=True):
        for code, message in units.lens_problems(camera):
            yield Finding(code, f"{view.where}: {message}")
    if not near_lights(capture):
        return
    for view in spec.views:
        if not view.lens:
            message = (
                "has no field of view, so the picture is taken for 2 units wide, in the unit of the light positions;"
                " add fov_degrees, the lens's angle over the width, or world_width, the width of what it shows"
            )
            yield Finding("lens", f"{view.where}: {message}")
    problems: list[units.Problem] = []
    if len(capture.cameras) > 1:
        problems += units.camera_problems(capture) if all(camera.perspective for camera in capture.cameras) else ()
    elif capture.card_distance is not None:
        problems += [*units.card_problems(capture), *units.strength_problems(capture, brightest(frames, capture))]
    elif not spec.views[0].placed:
        message = "near lights on a flat card need its distance from the camera, in the unit of their places; add"
        problems.append(("card_distance", f"{message} card_distance = … (of a mesh nothing is missing)"))
    yield from (Finding(code, f"{spec.source}: {message}") for code, message in problems)
