"""From a capture to a domain: on a flat card, or on a mesh."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Generator, Sequence
from pathlib import Path

import numpy as np

from ..capture.camera import Camera
from ..capture.steps import run_steps
from ..capture.types import Capture, Light, Observation
from ..errors import InputError
from .bake import bake_camera, bake_uv
from .domain import Domain, GeometryBake
from .mesh import MeshData
from .project import GRAZING, Projector


def domain_from_card(capture: Capture, depth: float = 1.0, scratch: Path | None = None) -> Domain:
    """Return the domain of a flat subject seen by one camera: its texels are the image's pixels.

    Everything is in the camera's own frame, where the card's normal is (0, 0, 1): lights and view are turned into it.
    depth: how far from a perspective camera the card lies, in world units; it matters for near lights and for how
    the view changes over the image. scratch: the folder for a file that holds the sample stack, None for memory; the
    file goes when the domain does. Raises InputError for several cameras, images of another size or nothing to see.
    """
    return run_steps(card_steps(capture, depth, scratch))


def card_steps(capture: Capture, depth: float = 1.0, scratch: Path | None = None) -> Generator[None, None, Domain]:
    """Yield before each image is read, and return what ``domain_from_card`` does: for callers that must not wait."""
    mask = check_card(capture)
    camera = capture.cameras[0]
    local = Camera(camera.width, camera.height, camera.scale, camera.centre, np.eye(4), camera.perspective)
    stack = new_stack(len(capture.observations), *mask.shape, scratch)
    for observation, out in zip(capture.observations, stack, strict=True):
        yield
        image = _read(observation, capture)
        seen = mask & (image[..., 3] > 0)
        out[seen] = image[seen]
    _check_seen(capture, stack, "the card")
    inverse = np.linalg.inv(np.asarray(camera.matrix, np.float64))
    views = np.broadcast_to(local.view, (len(stack), 4))
    return _domain(capture.observations, _card_bake(local, mask, depth), stack, views, inverse, card=True)


def check_card(capture: Capture) -> np.ndarray:
    """Return the (H, W) mask of a flat subject. Raises InputError where the capture cannot be one."""
    if len(capture.cameras) != 1:
        raise InputError(
            f"capture '{capture.name}' has {len(capture.cameras)} cameras, a flat card has one; give the mesh"
        )
    _check_masks(capture)
    mask = np.asarray(capture.masks[0], bool)
    if not mask.any():
        raise InputError(f"the mask of capture '{capture.name}' covers nothing; check mask.png")
    return mask


def domain_from_mesh(
    capture: Capture,
    mesh: MeshData,
    width: int,
    height: int,
    grazing: float = GRAZING,
    allow_overlap: bool = False,
    scratch: Path | None = None,
) -> Domain:
    """Return the domain of a mesh's UV square, width × height texels, with the capture's images projected into it.

    mesh: of ``extract_mesh``, in the capture's world. grazing: the least cosine, 0…1, between face and view at
    which a texel counts as seen. Observations are read one at a time. The domain's bake is a SurfaceBake, which
    ``frames`` needs. scratch: as for a card. Raises InputError for overlapping UVs (unless allowed), images of
    another size than their camera, or when no texel is seen by any camera.
    """
    return run_steps(mesh_steps(capture, mesh, width, height, grazing, allow_overlap, scratch))


def mesh_steps(
    capture: Capture,
    mesh: MeshData,
    width: int,
    height: int,
    grazing: float = GRAZING,
    allow_overlap: bool = False,
    scratch: Path | None = None,
) -> Generator[None, None, Domain]:
    """Yield before each camera and each image, and return what ``domain_from_mesh`` does."""
    _check_masks(capture)
    bake = bake_uv(mesh, width, height, allow_overlap)
    if not bake.coverage.any():
        raise InputError(f"no texel of {width} × {height} lies on '{mesh.name}' in its UV map; raise the resolution")
    projectors = {}
    for index in sorted({observation.camera for observation in capture.observations}):
        yield
        projectors[index] = Projector(bake, bake_camera(mesh, capture.cameras[index]), capture.cameras[index], grazing)
    stack = new_stack(len(capture.observations), height, width, scratch)
    for observation, out in zip(capture.observations, stack, strict=True):
        yield
        index = observation.camera
        out[:] = projectors[index].sample(_read(observation, capture), np.asarray(capture.masks[index], bool))
    _check_seen(capture, stack, f"mesh '{mesh.name}'")
    views = np.array([capture.cameras[observation.camera].view for observation in capture.observations])
    return _domain(capture.observations, bake, stack, views, np.eye(4), card=False)


def new_stack(observations: int, height: int, width: int, scratch: Path | None = None) -> np.ndarray:
    """Return (K, H, W, 4) zeros, in memory or mapped from a file in the folder ``scratch``."""
    shape = (observations, height, width, 4)
    return np.zeros(shape, np.float32) if scratch is None else mapped_array(scratch, shape)


def mapped_array(folder: Path, shape: tuple[int, ...], dtype: type = np.float32) -> np.ndarray:
    """Return zeros mapped from a temporary file in a folder; the file is gone with the array, or with the process.

    Raises InputError where the disk has no room: found out later, in the middle of a write, it would kill the process.
    """
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    try:
        with tempfile.TemporaryFile(prefix=".irpso-", dir=folder) as file:
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(file.fileno(), 0, size)
            elif shutil.disk_usage(folder).free < size:
                raise OSError(28, "no space left on device")
            return np.memmap(file, dtype, "w+", shape=shape).view(np.ndarray)
    except OSError as error:
        raise InputError(
            f"{folder}: holds no scratch file of {size / 2**30:.3g} GiB ({error.strerror or error}); set TMPDIR to a"
            " folder with room, or allow more with --memory host=…"
        ) from error


def _card_bake(camera: Camera, mask: np.ndarray, depth: float) -> GeometryBake:
    height, width = mask.shape
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    return GeometryBake(
        position=camera.points(depth).astype(np.float32),
        normal=np.tile(np.float32([0, 0, 1]), (height, width, 1)),
        tangent=np.tile(np.float32([1, 0, 0, 1]), (height, width, 1)),
        coverage=mask.copy(),
        uv=np.stack([u, v], axis=-1).astype(np.float32),
    )


def _domain(
    observations: Sequence[Observation],
    bake: GeometryBake,
    stack: np.ndarray,
    views: np.ndarray,
    to_frame: np.ndarray,
    card: bool,
) -> Domain:
    return Domain(
        bake=bake,
        stack=stack,
        lights=np.array([_light(observation.light, to_frame) for observation in observations], np.float32),
        intensities=np.array([observation.light.intensity for observation in observations], np.float32),
        views=np.asarray(views, np.float32),
        card=card,
    )


def _light(light: Light, to_frame: np.ndarray) -> np.ndarray:
    """Return (4,) a light in another frame: unit direction and 0, or position and 1."""
    vector = to_frame[:3, :3] @ np.asarray(light.vector, np.float64)
    if light.distant:
        return np.append(vector / np.linalg.norm(vector), 0.0)
    return np.append(vector + to_frame[:3, 3], 1.0)


def _read(observation: Observation, capture: Capture) -> np.ndarray:
    camera = capture.cameras[observation.camera]
    image = np.asarray(observation.read(), np.float32)
    if image.shape != (camera.height, camera.width, 4):
        height, width = image.shape[:2]
        raise InputError(
            f"image '{observation.name}' is {width} × {height}, its camera {camera.width} × {camera.height};"
            " bring them to one size"
        )
    return image


def _check_masks(capture: Capture) -> None:
    if not capture.observations:
        raise InputError(f"capture '{capture.name}' has no images")
    for camera, mask in zip(capture.cameras, capture.masks, strict=True):
        if mask.shape != (camera.height, camera.width):
            raise InputError(
                f"a mask of capture '{capture.name}' is {mask.shape[1]} × {mask.shape[0]},"
                f" its camera {camera.width} × {camera.height}; bring them to one size"
            )


def _check_seen(capture: Capture, stack: np.ndarray, what: str) -> None:
    if not any(((layer[..., 3] > 0) & (layer[..., :3] > 0).any(axis=-1)).any() for layer in stack):
        raise InputError(
            f"no image of capture '{capture.name}' shows {what} lit; check its cameras, masks and exposure"
        )
