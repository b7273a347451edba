"""``CaptureSpec``: the contents of a capture's files; and its conversion, with checks, to a ``Capture``."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path

import numpy as np

from ..core.steps import blocking
from .camera import Camera
from .errors import CaptureError, raise_all
from .framing import AUTO, Framing, distance_of_width
from .images.encoding import Encoding, LitImage, encoding_of
from .images.exif import SAME_STOPS, Exposure
from .images.image import ImageRef, ImageStore
from .images.linearise import Decoder, Samples
from .types import Capture, LeftOut, Light, Observation, triple

_LARGEST = 1e30  # of a light's numbers; a direction's largest number is at least the inverse


@dataclass(frozen=True)
class ObservationSpec:
    """One observation of a file. vector, axis: as in the file, of any length. where: file and line, for errors.

    axis, cone, cosine: as Light's.
    """

    name: str
    image: ImageRef
    vector: tuple[float, ...]
    where: str
    intensity: tuple[float, ...] = (1.0, 1.0, 1.0)
    distant: bool = True
    camera: int = 0
    axis: tuple[float, ...] | None = None
    cone: float | None = None
    cosine: float = 0.0


@dataclass(frozen=True)
class ViewSpec:
    """One camera of a file. make: (width, height) → Camera. size: in the file; None for that of its images.

    placed: whether its pose is not the identity (at the origin, looking along −z). where: file and place, for errors.
    lens: whether the file gives a focal length, angle or width; else the camera is orthographic, 2 units wide. foreign:
    whether another program's file (``cameras``) gives it. doubt: returns a warning about its images, "" for none.
    """

    name: str
    make: Callable[[int, int], Camera]
    where: str
    size: tuple[int, int] | None = None
    mask: ImageRef | None = None
    placed: bool = False
    lens: bool = True
    foreign: bool = False
    doubt: Callable[[], str] = str


class CaptureKind(StrEnum):
    """The format of a capture's files, in words (formats/registry.py); IMAGES: photographs whose lights are unknown."""

    TABLE = "capture table"
    DILIGENT = "DiLiGenT folder"
    RTI = "RTI light positions"
    IMAGES = "images"


@dataclass(frozen=True)
class CaptureSpec:
    """The contents of a capture's files.

    card_distance, left_out: as Capture's. framing: of its images; ``build_steps`` does not apply it.
    """

    name: str
    kind: CaptureKind
    source: Path
    observations: tuple[ObservationSpec, ...]
    views: tuple[ViewSpec, ...]
    card_distance: float | None = None
    left_out: tuple[LeftOut, ...] = ()
    framing: Framing = Framing()

    @property
    def states_distance(self) -> bool:
        """Whether the files state the distance or the width of a flat card."""
        return self.card_distance is not None or self.framing.card_width is not None


def reframed(spec: CaptureSpec, framing: Framing, store: ImageStore) -> CaptureSpec:
    """Return the spec with another framing, which keeps the spec's card_width.

    That width is of the spec's own part of the images: for another part it becomes ``card_distance``. Reads one header.
    Raises CaptureError where the own part is not known.
    """
    own, new = spec.framing, replace(spec, framing=framing)
    same = (framing.crop, framing.corners) == (own.crop, own.corners) or (own.corners == AUTO and framing.corners)
    if own.card_width is None or same or len(spec.views) != 1:
        return new
    if own.corners == AUTO:
        raise CaptureError(
            f'{spec.source}: its card_width is of the part by corners = "auto", not of this one; give --card-width'
            " (Card Width)",
            "value",
        )
    size = spec.views[0].size or _first_size(spec, store)
    distance = distance_of_width(spec.views[0].make(*size), own)
    return replace(new, card_distance=distance, framing=replace(framing, card_width=None))


def _first_size(spec: CaptureSpec, store: ImageStore) -> tuple[int, int]:
    """Return the size of the first image that can be read. Raises CaptureError if none can."""
    for observation in spec.observations[:-1]:
        with suppress(CaptureError):  # a damaged one may be left out later
            return store.size(observation.image)
    return store.size(spec.observations[-1].image)


def build_steps(spec: CaptureSpec, decoder: Decoder | None = None) -> Generator[None, None, Capture]:
    """Return the Capture of a spec. Reads masks and all headers now, images at first use.

    Yields before each header and each mask. Raises CaptureError with the first fault, and the rest in its ``others``.
    """
    store = ImageStore(decoder)
    faults: list[CaptureError] = []
    lights = [_light(observation, faults) for observation in spec.observations]
    sizes = []
    for observation in spec.observations:
        yield
        sizes.append(_size(observation.image, store, faults))
    raise_all(faults)
    read = zip(spec.observations, lights, sizes, strict=True)
    usable = [(observation, light, size) for observation, light, size in read if light and size]
    cameras, masks, warnings = [], [], []
    for index, view in enumerate(spec.views):
        yield
        of_view = [(observation, size) for observation, _, size in usable if observation.camera == index]
        width, height = _camera_size(view, of_view, faults)
        faults += orientation_faults([observation.image for observation, _ in of_view], store)
        cameras.append(view.make(width, height))
        masks.append(_mask(view, (width, height), store, faults))
        doubts = view.doubt(), _mask_doubt(view, [observation.image for observation, _ in of_view], store)
        warnings += [doubt for doubt in doubts if doubt]
        warnings += yield from _exposure_warnings([observation for observation, _ in of_view], store)
    raise_all(faults)
    tested = [
        LitImage(observation.image, light.vector, float(np.mean(light.intensity)), observation.camera)
        for observation, light, _ in usable
        if light.distant and observation.image.colour_space == "auto"
    ]
    encoding = encoding_of(tested, masks, store)
    observations = tuple(
        Observation(
            observation.name,
            ImageReader(observation.image, store, cameras[observation.camera], encoding),
            light,
            observation.camera,
            store.coarse(observation.image),
        )  # fmt: skip
        for observation, light, _ in usable
    )
    return Capture(
        spec.name, observations, tuple(cameras), tuple(masks), spec.source, spec.card_distance, spec.left_out,
        encoding, tuple(warnings),
    )  # fmt: skip


build_capture = blocking("build_capture", build_steps)


@dataclass(frozen=True)
class ImageReader:
    """Reads one observation: the ``Observation.read`` of captures from files."""

    image: ImageRef
    store: ImageStore
    camera: Camera
    encoding: Encoding | None = None

    def __call__(self) -> np.ndarray:
        return self.samples().bounds

    def samples(self) -> Samples:
        """Return the Samples of the image. Raises CaptureError if its size is not the camera's."""
        samples = self.store.samples(self._resolved())
        height, width = samples.rgba.shape[:2]
        if (width, height) != (self.camera.width, self.camera.height):
            raise size_fault(self.image, (width, height), (self.camera.width, self.camera.height))
        return samples

    def _resolved(self) -> ImageRef:
        """Return the image's reference, with the measured colour space if its file states none."""
        guessed = self.image.colour_space == "auto" and self.store.encoding(self.image)[1] == "guess"
        if not guessed or self.encoding is None or self.encoding.known_by != "guess":
            return self.image
        return replace(self.image, colour_space=self.encoding.colour_space)


def written_lights(spec: CaptureSpec) -> list[Light]:
    """Return the lights of a spec's observations; [] if one of them is invalid."""
    faults: list[CaptureError] = []
    lights = [_light(observation, faults) for observation in spec.observations]
    return [light for light in lights if light] if not faults else []


def _is_direction(vector: np.ndarray) -> bool:
    return 1 / _LARGEST < np.abs(vector).max() < _LARGEST


def _light(observation: ObservationSpec, faults: list[CaptureError]) -> Light | None:
    vector, intensity = np.asarray(observation.vector, float), np.asarray(observation.intensity, float)
    axis = np.asarray(observation.axis or (0, 0, 1), float)
    if not np.isfinite(vector).all():
        fault = f"{observation.where}: the light is not a number; write three finite numbers", "light_nan"
    elif np.abs(vector).max() >= _LARGEST:
        fault = f"{observation.where}: the light is out of range; write numbers below {_LARGEST:g}", "light_nan"
    elif observation.distant and not _is_direction(vector):
        fault = f"{observation.where}: the light direction is zero; write the direction toward the light", "light_zero"
    elif not _is_direction(axis):
        fault = f"{observation.where}: light_axis is no direction; write where the light shines to", "light_zero"
    elif not np.isfinite(intensity).all():
        fault = f"{observation.where}: the intensity is not a number; write one or three finite numbers", "intensity"
    elif (intensity < 0).any() or not intensity.any():
        what = "negative" if (intensity < 0).any() else "zero"
        fault = (
            f"{observation.where}: the intensity is {what}; write the light's intensity, or remove the image",
            "intensity",
        )
    else:
        direction = vector / np.linalg.norm(vector) if observation.distant else vector
        unit_axis = None if observation.axis is None else triple(axis / np.linalg.norm(axis))
        return Light(
            triple(direction), triple(intensity), observation.distant, unit_axis, observation.cone, observation.cosine
        )
    faults.append(CaptureError(*fault))
    return None


def _size(image: ImageRef, store: ImageStore, faults: list[CaptureError]) -> tuple[int, int] | None:
    try:
        return store.size(image)
    except CaptureError as error:
        faults.append(error)
        return None


def _camera_size(
    view: ViewSpec, observations: list[tuple[ObservationSpec, tuple[int, int]]], faults: list[CaptureError]
) -> tuple[int, int]:
    if not observations and view.size is None:
        faults.append(CaptureError(f"{view.where}: no observation uses this camera; set width and height", "camera"))
        return 1, 1
    expected = common_size(view, [size for _, size in observations])
    faults += [size_fault(observation.image, size, expected) for observation, size in observations if size != expected]
    return expected


def orientation_faults(images: Sequence[ImageRef], store: ImageStore) -> list[CaptureError]:
    """Return an error for each image with another EXIF orientation than most: a phone that looks down guesses it."""
    tags = [(image, tag) for image in images if (tag := store.tag(image))]
    orientations = [tag for _, tag in tags]
    usual = max(orientations, key=orientations.count, default=1)
    return [
        CaptureError(
            f"{image}: its EXIF orientation is {tag} where the camera's other images have {usual}; the camera stands"
            " still, so give all of them the same orientation",
            "orientation",
        )
        for image, tag in tags
        if tag != usual
    ]


def _exposure_warnings(observations: list[ObservationSpec], store: ImageStore) -> Generator[None, None, list[str]]:
    """Return a warning if one camera's images have different exposures by EXIF, and their lights equal intensities.

    Yields before each image. Files of which only some have an f-number or an ISO are not compared.
    """
    if len({observation.intensity for observation in observations}) != 1:
        return []  # intensities may account for the exposures
    exposed: list[tuple[ImageRef, Exposure]] = []
    for observation in observations:
        yield
        if exposure := store.exposure(observation.image):
            exposed.append((observation.image, exposure))
    if len({(exposure.f_number is None, exposure.iso is None) for _, exposure in exposed}) != 1:
        return []
    stops = np.log2([exposure.amount for _, exposure in exposed])
    stops -= np.sort(stops)[len(stops) // 2]
    worst, count = int(np.abs(stops).argmax()), int((np.abs(stops) >= SAME_STOPS).sum())
    if not count:
        return []
    return [
        f"{exposed[worst][0]}: its exposure by EXIF is {abs(stops[worst]):.1f} stops"
        f" {'above' if stops[worst] > 0 else 'below'} the median ({count} of {len(stops)} photographs differ from it),"
        " which counts as a stronger or weaker lamp; set the exposure by hand, scale with irpso develop --exposure"
        " exif, or recover with --intensities estimate"
    ]


def common_size(view: ViewSpec, sizes: list[tuple[int, int]]) -> tuple[int, int]:
    """Return the size that a camera's images must have: the file's, or the most frequent one."""
    return view.size or max(sizes, key=sizes.count)


def size_fault(image: ImageRef, size: tuple[int, int], expected: tuple[int, int]) -> CaptureError:
    """Return the error for an image whose size (width, height) differs from its camera's."""
    return CaptureError(
        f"{image}: is {size[0]}×{size[1]} pixels where its camera has {expected[0]}×{expected[1]};"
        " all images of a camera must be of one size, unscaled and uncropped",
        "size",
    )


def _mask(view: ViewSpec, size: tuple[int, int], store: ImageStore, faults: list[CaptureError]) -> np.ndarray:
    all_pixels = np.ones(size[::-1], bool)
    if view.mask is None:
        return all_pixels
    try:
        mask_size = store.size(view.mask)
        if mask_size != size:
            remedy = "save it at the images' size"
            if mask_size == size[::-1]:
                remedy = "turn it upright, as viewers show the images: some programs write it as they are stored"
            what = f"the mask is {mask_size[0]}×{mask_size[1]} pixels, the images {size[0]}×{size[1]}"
            raise CaptureError(f"{view.mask}: {what}; {remedy}", "mask_size")
        mask = store.mask(view.mask)
        if not mask.any():
            raise CaptureError(f"{view.mask}: the mask is empty; paint what is to be solved white", "mask_empty")
        return mask
    except CaptureError as error:  # another code than an image's: skipping images does not help
        code = error.code if error.code.startswith("mask") else f"mask_{error.code}"
        faults.append(CaptureError(error.message, code))
        return all_pixels


def _mask_doubt(view: ViewSpec, images: Sequence[ImageRef], store: ImageStore) -> str:
    """Return a warning if a mask may lie as the stored photographs do, whose camera another program gave; "" if not.

    Metashape and COLMAP write masks so, without an EXIF orientation. After a quarter turn (5 to
    8) its size tells, unless the photographs are square.
    """
    if view.mask is None or not view.foreign or not images:
        return ""
    turned_by, own = store.turned_by(images[0]), 0
    with suppress(CaptureError):  # _mask reports it
        own = store.turned_by(view.mask)
    width, height = store.size(images[0])
    if turned_by == 1 or own != 1 or (turned_by >= 5 and width != height):
        return ""
    return (
        f"{view.mask}: the photographs have the EXIF orientation {turned_by}, the mask none; it must be upright, as"
        " viewers show the photographs: turn a mask that Metashape or COLMAP wrote"
    )
