"""Domains from captures: on a flat card, or on a mesh."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Generator, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from ..capture.bounds import bounded, weight_and_clipped
from ..capture.camera import Camera
from ..capture.card import card_depth
from ..capture.noise import NoiseEstimate
from ..capture.types import Capture, Light, Observation, triple
from ..core.errors import InputError
from ..core.steps import blocking
from .domain import Domain, GeometryBake, domain_of, flat_bake
from .light.light_shape import beam_correction
from .light.shadows import ShadowCaster, texel_size
from .project import GRAZING, Projector, blocks, filled
from .samples import ArrayStack, new_stack
from .seams.seams import SeamMap, seams_of, window_seams
from .surface.bake import SurfaceBake, bake_camera, bake_uv
from .surface.footprint import texel_steps
from .surface.mesh import MeshData

Window = tuple[int, int, int, int]
Surface = tuple[SurfaceBake, SeamMap]
Bake = TypeVar("Bake", bound=GeometryBake)


def card_steps(
    capture: Capture, scratch: Path | None = None, window: Window | None = None
) -> Generator[None, None, Domain]:
    """Return the domain of a flat subject seen by one camera: its texels are the image's pixels.

    Yields before each image. The frame is the camera's, with the card's normal at (0, 0, 1); lights and view are
    rotated into it. The card lies at the capture's ``card_distance``, which near lights need. scratch: folder for a
    temporary file with the sample stack, None for memory. window: (x0, y0, width, height) of the texels to hold; values
    and origin equal those of ``tile``. Raises InputError for several cameras, near lights without the card's distance,
    images of another size or, without a window, no lit texel; ValueError where the window leaves the domain.
    """
    yield from _encoding_steps(capture)
    camera = capture.cameras[0]
    bake, noise = card_bake(capture), NoiseEstimate(capture)
    x0, y0, width, height = window or (0, 0, *bake.coverage.shape[::-1])
    if window is not None:
        bake = _windowed(bake, window)
    inverse = np.linalg.inv(np.asarray(camera.matrix, np.float64))
    stack = new_stack(len(capture.observations), height, width, scratch)
    texels = np.flatnonzero(bake.coverage)
    for observation, out in zip(capture.observations, stack.layers(), strict=True):
        yield
        whole = _read(observation, capture)
        noise.take(observation, whole)
        image = whole[y0 : y0 + height, x0 : x0 + width]
        shown = bake.coverage & ((image[..., 3] > 0) | _finite(image))
        if shown.all():
            out[:] = image
        else:
            out[shown] = image[shown]
        if observation.light.axis is not None:
            # Not @: its rounding of a texel's sum may depend on the array's size.
            points = np.einsum("nj,ij->ni", bake.position.reshape(-1, 3), camera.matrix[:3, :3]) + camera.matrix[:3, 3]
            _scale_samples(out, texels, *_beam_correction(observation.light, points, texels))
    views = np.broadcast_to(_at_origin(camera).view, (len(capture.observations), 4))
    domain = _domain(capture, bake, stack, views, inverse, card=True, noise=(yield from noise.finishing()))
    if window is None:
        check_seen(capture.name, domain, "the card")
    return replace(domain, origin=(x0, y0))


domain_from_card = blocking("domain_from_card", card_steps)


def loading_steps(capture: Capture, on_mesh: bool) -> int:
    """Return the number of steps of ``card_steps``, an upper bound for ``mesh_steps``, which adds one per camera."""
    return len(capture.observations) + (len(capture.cameras) if on_mesh else 0)


def card_bake(capture: Capture) -> GeometryBake:
    """Return the geometry of the domain of a flat subject, without reading an image. Raises InputError."""
    mask = check_card(capture)
    return _card_bake(_at_origin(capture.cameras[0]), mask, card_depth(capture))


def card_lights(capture: Capture) -> np.ndarray:
    """Return (K, 4) the lights of the domain of a flat subject, without reading an image."""
    inverse = np.linalg.inv(np.asarray(capture.cameras[0].matrix, np.float64))
    return np.array([_light(observation.light, inverse) for observation in capture.observations], np.float32)


def _encoding_steps(capture: Capture) -> Generator[None, None, None]:
    """Yield before each image that is read to determine the encoding of the files."""
    if capture.encoding is not None:
        yield from capture.encoding.resolve_steps()


def _at_origin(camera: Camera) -> Camera:
    return replace(camera, matrix=np.eye(4))


def check_card(capture: Capture) -> np.ndarray:
    """Return the (H, W) mask of a flat subject. Raises InputError where the capture is not of a card."""
    if len(capture.cameras) != 1:
        raise InputError(
            f"capture '{capture.name}' has {len(capture.cameras)} cameras, a flat card has one; add the mesh"
        )
    card_depth(capture)
    _check_masks(capture)
    mask = np.asarray(capture.masks[0], bool)
    if not mask.any():
        raise InputError(f"the mask of capture '{capture.name}' covers nothing; check mask.png")
    return mask


def mesh_steps(
    capture: Capture,
    mesh: MeshData,
    width: int,
    height: int,
    grazing: float = GRAZING,
    allow_overlap: bool = False,
    scratch: Path | None = None,
    *,
    shadows: bool = True,
    falloff: bool = True,
    areas: bool = True,
    window: Window | None = None,
    surface: Surface | None = None,
) -> Generator[None, None, Domain]:
    """Return the domain of a mesh's UV square, width × height texels, with the capture's images projected into it.

    mesh: from ``extract_mesh``, in the capture's world. grazing: least cosine, 0…1, between face normal and view of a
    visible texel. Yields before each camera and each image; observations are read light by light. The domain's bake is
    a SurfaceBake, for ``frames``. scratch: as for a card. shadows: lower the weight of samples that the mesh shades.
    falloff: lower the weight of slanted samples. areas: a texel of several pixels is their mean; else images are read
    at texel centres. window: (x0, y0, width, height) of the texels to hold; values and origin equal those of ``tile``;
    images that do not show it are not read. surface: from ``mesh_surface``, computed where None. Raises InputError for
    overlapping UVs (unless allowed), images of another size than their camera, or, without a window, no visible texel;
    ValueError where the window leaves the domain.
    """
    _check_masks(capture)
    yield from _encoding_steps(capture)
    bake, seams = surface or mesh_surface(mesh, width, height, allow_overlap)
    texel = texel_size(mesh, bake)
    if window is not None:
        bake, seams = _windowed(bake, window), window_seams(seams, window)
    caster = ShadowCaster(mesh, bake, texel) if shadows else None
    steps = texel_steps(mesh, width, height) if areas else None

    def project(index: int) -> Projector:
        camera = capture.cameras[index]
        return Projector(bake, bake_camera(mesh, camera), camera, grazing, steps, falloff)

    rows, columns = bake.coverage.shape
    stack, noise = new_stack(len(capture.observations), rows, columns, scratch), NoiseEstimate(capture)
    unseen, shaded = yield from _fill(stack, capture, bake, project, caster, noise)
    views = np.array([capture.cameras[observation.camera].view for observation in capture.observations])
    domain = _domain(capture, bake, stack, views, np.eye(4), card=False, noise=(yield from noise.finishing()))
    domain = replace(domain, seams=seams, origin=(0, 0) if window is None else window[:2], unseen=unseen, shaded=shaded)
    if window is None:
        check_seen(capture.name, domain, f"mesh '{mesh.name}'")
    return domain


domain_from_mesh = blocking("domain_from_mesh", mesh_steps)


def mesh_surface(mesh: MeshData, width: int, height: int, allow_overlap: bool = False) -> Surface:
    """Return the bake of a mesh's UV square, width × height texels, and its seams. Raises InputError."""
    bake = bake_uv(mesh, width, height, allow_overlap)
    if not bake.coverage.any():
        raise InputError(f"no texel of {width} × {height} lies on '{mesh.name}' in its UV map; raise the resolution")
    return bake, seams_of(mesh, bake.triangle)


def _windowed(bake: Bake, window: Window) -> Bake:
    """Return a copy of the texels of a window."""
    (x0, y0, width, height), (rows, columns) = window, bake.coverage.shape
    if not (width > 0 and height > 0 and 0 <= x0 <= columns - width and 0 <= y0 <= rows - height):
        raise ValueError(f"window {width}×{height} at ({x0}, {y0}) leaves the domain of {columns}×{rows}")
    part = (slice(y0, y0 + height), slice(x0, x0 + width))
    return type(bake)(**{item.name: getattr(bake, item.name)[part].copy() for item in fields(bake)})


def _fill(
    stack: ArrayStack,
    capture: Capture,
    bake: SurfaceBake,
    project: Callable[[int], Projector],
    caster: ShadowCaster | None,
    noise: NoiseEstimate,
) -> Generator[None, None, tuple[tuple[int, ...], tuple[int, ...]]]:
    """Read the images into the stack, yielding before each: light by light, because images of one light share shadows.

    Returns ``Domain.unseen``, whose images are not read, and ``Domain.shaded``. project: camera index → Projector. A
    Projector holds about 50 bytes per visible texel, three times an image's 16; each is made for its camera's first
    image and freed after the last.
    """
    left = Counter(observation.camera for observation in capture.observations)
    projectors: dict[int, Projector] = {}
    blind: set[int] = set()
    shaded: list[int] = []
    for light, numbers in _by_light(capture.observations).items():
        cameras = Counter(capture.observations[k].camera for k in numbers)
        for index in sorted(set(cameras) - set(projectors)):
            yield
            projectors[index] = project(index)
            if not projectors[index].visible.any():
                blind.add(index)
        shaded += yield from _fill_light(stack, capture, bake, projectors, caster, light, numbers, noise)
        left -= cameras
        projectors = {index: projector for index, projector in projectors.items() if left[index]}
    unseen = tuple(k for k, observation in enumerate(capture.observations) if observation.camera in blind)
    return unseen, tuple(sorted({*unseen, *shaded}))


def _fill_light(
    stack: ArrayStack,
    capture: Capture,
    bake: SurfaceBake,
    projectors: dict[int, Projector],
    caster: ShadowCaster | None,
    light: Light,
    numbers: Sequence[int],
    noise: NoiseEstimate,
) -> Generator[None, None, list[int]]:
    """Read the images under one light, the observations ``numbers``, yielding before each; return the shaded ones."""
    seen = {index: projectors[index].visible for index in {capture.observations[k].camera for k in numbers}}
    texels = np.flatnonzero(np.logical_or.reduce(list(seen.values())))
    if not len(texels):
        return list(numbers)
    gain, weight = _beam_correction(light, bake.position.reshape(-1, 3), texels)
    shaded = []
    if caster is not None:
        lit = caster.weights(light, texels)
        weight = weight * lit
        reached = {index: (lit[there.ravel()[texels]] > 0).any() for index, there in seen.items()}
        shaded = [k for k in numbers if not reached[capture.observations[k].camera]]
    for k in numbers:
        index = capture.observations[k].camera
        if not seen[index].any():
            continue
        yield
        image = _read(capture.observations[k], capture)
        noise.take(capture.observations[k], image)
        stack.layer(k)[:] = projectors[index].sample(image, np.asarray(capture.masks[index], bool))
        _scale_samples(stack.layer(k), texels, gain, weight)
    return shaded


def _by_light(observations: Sequence[Observation]) -> dict[Light, list[int]]:
    """Return light → observation indices; lights that differ in intensity alone are one."""
    numbers: dict[Light, list[int]] = {}
    for number, observation in enumerate(observations):
        light = observation.light
        axis = None if light.axis is None else triple(light.axis)
        place = replace(light, vector=triple(light.vector), intensity=(1.0, 1.0, 1.0), axis=axis)
        numbers.setdefault(place, []).append(number)
    return numbers


def _beam_correction(light: Light, positions: np.ndarray, texels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (N,) gains of radiance and (N,) weights for the light's beam; texels: flat indices into positions."""
    gain, weight = np.ones(len(texels), np.float32), np.ones(len(texels), np.float32)
    if light.axis is not None:
        for part in blocks(np.arange(len(texels))):
            shape = beam_correction(light, positions[texels[filled(part)]].astype(np.float64))
            gain[part], weight[part] = (values[: len(part)] for values in shape)
    return gain, weight


def _scale_samples(layer: np.ndarray, texels: np.ndarray, gain: np.ndarray, weight: np.ndarray) -> None:
    """Multiply radiance and weight of a layer (H, W, 4) at texels (flat indices); at gain 0 the radiance stays."""
    if (gain == 1).all() and (weight == 1).all():
        return
    values = layer.reshape(-1, 4)[texels]
    own, clipped = weight_and_clipped(values[:, 3])
    values[:, 3] = bounded(np.maximum(own * weight, 0), clipped)
    values[:, :3] *= np.where(gain > 0, gain, 1)[:, None]
    layer.reshape(-1, 4)[texels] = values


def _card_bake(camera: Camera, mask: np.ndarray, depth: float) -> GeometryBake:
    height, width = mask.shape
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    position = camera.points(depth)
    shown = np.isfinite(position).all(axis=-1)
    return flat_bake(np.where(shown[..., None], position, 0), mask & shown, np.stack([u, v], axis=-1))


def _domain(
    capture: Capture,
    bake: GeometryBake,
    stack: ArrayStack,
    views: np.ndarray,
    to_frame: np.ndarray,
    card: bool,
    noise: float,
) -> Domain:
    observations, beams = capture.observations, None
    lights = np.array([_light(observation.light, to_frame) for observation in observations], np.float32)
    if any(observation.light.axis is not None for observation in observations):
        shapes = np.array([observation.light.beam for observation in observations])
        axes = shapes[:, :3] @ to_frame[:3, :3].T
        beams = np.concatenate([lights[:, :3], axes, shapes[:, 3:]], axis=-1, dtype=np.float32)
    domain = domain_of(
        bake,
        stack.values,
        lights=lights,
        intensities=np.array([observation.light.intensity for observation in observations], np.float32),
        views=np.asarray(views, np.float32),
        card=card,
        noise=noise,
    )
    return replace(domain, beams=beams)


def _light(light: Light, to_frame: np.ndarray) -> np.ndarray:
    """Return a light in another frame (4,): unit direction and 0, or position and 1."""
    vector = to_frame[:3, :3] @ np.asarray(light.vector, np.float64)
    if light.distant:
        return np.append(vector / np.linalg.norm(vector), 0.0)
    return np.append(vector + to_frame[:3, 3], 1.0)


def _read(observation: Observation, capture: Capture) -> np.ndarray:
    camera = capture.cameras[observation.camera]
    image = np.asarray(observation.read(), np.float32)
    if image.ndim != 3 or image.shape[2] != 4:
        raise InputError(f"image '{observation.name}' has the shape {image.shape}; give (H, W, 4): RGB and weight")
    if image.shape[:2] != (camera.height, camera.width):
        height, width = image.shape[:2]
        raise InputError(
            f"image '{observation.name}' is {width} × {height}, its camera {camera.width} × {camera.height};"
            " scale them to one size"
        )
    return image


def _finite(image: np.ndarray) -> np.ndarray:
    """Return (H, W) bool: all channels of (H, W, 4) are finite. all() over an axis of four is ten times slower."""
    finite = np.isfinite(image)
    return finite[..., 0] & finite[..., 1] & finite[..., 2] & finite[..., 3]


def _check_masks(capture: Capture) -> None:
    if not capture.observations:
        raise InputError(f"capture '{capture.name}' has no images")
    for camera, mask in zip(capture.cameras, capture.masks, strict=True):
        if mask.shape != (camera.height, camera.width):
            raise InputError(
                f"a mask of capture '{capture.name}' is {mask.shape[1]} × {mask.shape[0]},"
                f" its camera {camera.width} × {camera.height}; bring them to one size"
            )


def check_seen(name: str, domain: Domain, what: str) -> None:
    """Raise InputError where a capture's images show nothing lit. name: the capture's. what: "the card" or the mesh."""
    if len(domain.shaded) == domain.observations > len(domain.unseen):
        raise InputError(
            f"capture '{name}': no light reaches what its cameras see of {what}, by the shadows of the mesh and its"
            " occluders; leave the lamps' own housings out of the occluders, check the lights, or do not predict"
            " shadows (--no-shadows)"
        )
    if not domain.solvable.any():
        raise InputError(
            f"no image of capture '{name}' shows {what} lit; check its cameras, masks and exposure"
            + ("" if domain.card else ", and that its normals point outward (Mesh › Normals › Recalculate Outside)")
        )
