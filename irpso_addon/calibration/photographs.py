"""Input of calibrations: a capture, or a folder of images or videos without lights; and output as capture.toml."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

from ..capture import read
from ..capture.camera import Camera
from ..capture.errors import CaptureError
from ..capture.formats import diligent, table
from ..capture.formats.lists import read_lines
from ..capture.formats.registry import captures_with_lights
from ..capture.formats.toml_file import CAMERA_KEYS, camera_maker, has_lens, known_keys, load_toml
from ..capture.images.exif import JPEG_START, field_of_view, lens_of, open_jpeg, orientation_of, tags_of
from ..capture.images.exr_header import is_exr
from ..capture.images.headers import read_bytes
from ..capture.images.image import SUFFIXES, ImageRef, ImageStore, find_image
from ..capture.images.linearise import Decoder
from ..capture.images.raw import is_raw
from ..capture.spec import CaptureKind, CaptureSpec, ObservationSpec, ViewSpec
from ..capture.types import Light
from ..core.files import visible
from ..core.toml_text import toml_value

_VIDEO_SUFFIXES = (
    ".avi", ".m2ts", ".m4v", ".mkv", ".mov", ".mp4", ".mpeg", ".mpg", ".mts", ".ogv", ".webm", ".wmv",
)  # fmt: skip
CameraMaker = Callable[[int, int], Camera]
CAMERA = "camera.toml"
_JPEG_SUFFIXES = (".jpg", ".jpeg")
_BEGINNING = 1 << 18  # bytes of a JPEG file: EXIF, at most 64 KiB, comes before profile, preview and size
_WITHOUT_LENS = 4  # photographs read before all are taken to be without a lens in their EXIF
_UNKNOWN = (0.0, 0.0, 1.0)  # placeholder until the balls give the light
_UNMEASURED = (1.0, 1.0, 1.0)  # intensity of lights whose calibration finds directions only
_LIGHT_KEYS = (
    "light_direction", "light_position", "light_intensity", "light_axis", "light_cone_degrees", "light_cosine",
)  # fmt: skip
_EITHER = ({"crop", "corners"}, {"card_width", table.CARD_DISTANCE})  # mutually exclusive keys
# Keys of a camera that this key alone does not replace.
_KEPT_BESIDE = {"fov_degrees": {"principal_point", "distortion"}, "world_width": {"principal_point"}}
_PATH_KEYS = ("image", "mask", "cameras")


def is_photograph(path: Path) -> bool:
    """Return whether a file's suffix is that of a supported image."""
    return path.suffix.lower() in SUFFIXES or is_raw(path)


def videos_of(path: Path) -> list[Path]:
    """Return the videos of a path: itself, or those of a folder without lists, sorted by name.

    Videos with a photograph's name belong to a phone's live photographs and are ignored.
    """
    if path.suffix.lower() in _VIDEO_SUFFIXES and path.is_file():
        return [path]
    if not path.is_dir() or has_lights(path) or (path / diligent.FILENAMES).exists():
        return []
    files = visible(path)
    photographs = {p.stem.lower() for p in files if is_photograph(p)}
    return [p for p in files if p.suffix.lower() in _VIDEO_SUFFIXES and p.stem.lower() not in photographs]


def has_lights(folder: Path) -> bool:
    """Return whether a folder holds exactly one capture with lights."""
    return len(captures_with_lights(folder)) == 1


def read_photographs(
    path: Path, colour_space: str = "auto", leave_out: Sequence[Path] = (), frames: Sequence[Path] = ()
) -> CaptureSpec:
    """Return the spec of a capture, or of a folder of images or videos with placeholder lights.

    Images of a folder: those in filenames.txt, else all except masks, pictures of calibrations and ``leave_out``,
    sorted by name; then ``frames``, of its videos or of the video at ``path``. Its camera.toml gives the camera. Raises
    InputError if there are no images.
    """
    path = Path(path)
    if frames and path.is_file():
        path, frames = frames[0].parent, ()
    if path.is_file() and is_photograph(path):
        raise CaptureError(f"{path}: is one photograph; give the folder of all of them", "kind")
    names = path / diligent.FILENAMES
    if not path.is_dir() or has_lights(path):
        return read.read_spec(path, colour_space)
    hidden = {p.resolve() for p in (*leave_out, *_pictures_of_tables(path))}
    if names.exists():
        images = [find_image(path, name) for _, name in read_lines(names, "write the image names into it")]
    else:
        images = [
            p for p in visible(path) if is_photograph(p) and not diligent.is_mask(p) and p.resolve() not in hidden
        ]
        images += frames
    if not images:
        raise CaptureError(f"{path}: holds no images; give the folder of the photographs", "kind")
    observations = tuple(
        ObservationSpec(p.name, ImageRef(p, colour_space=colour_space), _UNKNOWN, str(p)) for p in images
    )
    keys = camera_keys(path / CAMERA) if (path / CAMERA).exists() else {}
    mask = diligent.mask_of(path, hidden)
    make, lens = camera_maker(keys, str(path / CAMERA)), has_lens(keys)
    view = ViewSpec("camera", make, str(path), None, ImageRef(mask) if mask else None, lens=lens)
    return CaptureSpec(path.resolve().name, CaptureKind.IMAGES, path, observations, (view,))


def _pictures_of_tables(folder: Path) -> list[Path]:
    """Return the pictures that calibrations have written beside tables in a folder: NAME_balls.png of NAME.toml."""
    return [p for p in folder.glob("*_balls.png") if p.with_name(f"{p.stem.removesuffix('_balls')}.toml").is_file()]


def camera_keys(path: Path) -> dict[str, Any]:
    """Return the keys of a camera.toml. Raises InputError at an unknown key."""
    keys = load_toml(path)
    known_keys(keys, CAMERA_KEYS, str(path))
    return keys


def with_camera(spec: CaptureSpec, keys: Mapping[str, Any], where: str) -> CaptureSpec:
    """Return a spec whose cameras have the intrinsics of ``keys`` and keep their poses. where: names the option.

    An angle alone leaves principal point and distortion as they are, a width alone the principal point. Raises
    CaptureError for a camera of another program's file.
    """
    views = []
    for view in spec.views:
        if view.foreign:
            raise CaptureError(
                f"{view.where}: its lens is that of this file, which cameras in {spec.source.name} names; leave {where}"
                " out, or correct the lens there",
                "camera",
            )
        matrix = view.make(*(view.size or (1, 1))).matrix
        make = camera_maker(dict(keys), where, matrix)
        make = make if _replaced_keys(keys) == CAMERA_KEYS else partial(_with_lens, view.make, make)
        views.append(replace(view, make=make, lens=has_lens(keys)))
    return replace(spec, views=tuple(views))


def _replaced_keys(keys: Mapping[str, Any]) -> set[str]:
    """Return the keys of a camera that ``keys`` replace."""
    return CAMERA_KEYS - _KEPT_BESIDE.get(next(iter(keys)), set()) if len(keys) == 1 else CAMERA_KEYS


def _with_lens(former: CameraMaker, other: CameraMaker, width: int, height: int) -> Camera:
    """Return the camera of ``former`` with the focal length of ``other``."""
    kept, camera = former(width, height), other(width, height)
    return replace(camera, centre=kept.centre, distortion=kept.distortion if camera.perspective else ())


def lens_of_files(spec: CaptureSpec, decoder: Decoder | None = None) -> dict[str, Any]:
    """Return the field of view, as camera keys, by the EXIF of all photographs.

    {} if the capture states the lens or has several cameras, or no file has a lens, or they differ or were cropped.
    Files without a lens, as retouching leaves them, do not count, but if the first four have none, the others are not
    read. Pixels are not decoded, and of a JPEG file only the beginning is read. Raises CaptureError where a file cannot
    be read.
    """
    if len(spec.views) != 1 or spec.views[0].lens or is_exr(spec.observations[0].image.path):
        return {}
    store, found = ImageStore(decoder), None
    for number, observation in enumerate(spec.observations):
        data, (width, height) = _beginning(observation.image, store)
        if "focal_length_35mm" in lens_of(data):
            angle = field_of_view(data, width, height)
            if angle is None or found not in (None, round(angle, 4)):
                return {}
            found = round(angle, 4)
        elif found is None and number == _WITHOUT_LENS - 1:
            return {}
    return {} if found is None else {"fov_degrees": found}


def _beginning(image: ImageRef, store: ImageStore) -> tuple[bytes, tuple[int, int]]:
    """Return a file's bytes up to its EXIF block at least, and its upright (width, height)."""
    if image.path.suffix.lower() in _JPEG_SUFFIXES and image.path.is_file():
        head = read_bytes(image.path, _BEGINNING)
        if head.startswith(JPEG_START) and (picture := open_jpeg(head)) is not None:
            width, height = picture.size
            return head, (height, width) if orientation_of(tags_of(head)) >= 5 else (width, height)
    size = store.size(image)
    return read_bytes(image.path), size  # other formats may have EXIF at their end


def calibrated_table(
    spec: CaptureSpec,
    cameras: Mapping[int, Mapping[str, Any]],
    lights: Mapping[int, Light | None],
    folder: Path,
    card: Mapping[str, Any] = MappingProxyType({}),
) -> str:
    """Return the text of a capture.toml in ``folder``: that of the spec, with its lights replaced.

    cameras: camera index → keys, as of ``with_camera``. lights: observation's index → light; None removes it. If all
    have intensity 1, none was measured: each keeps the source's, if both are near or both distant. card: keys of the
    card, which replace the source's. Everything else of a capture.toml is preserved, except comments. Image paths
    become relative to ``folder``.
    """
    if spec.kind is CaptureKind.TABLE:
        source = load_toml(spec.source)
        home = spec.source.parent
    else:
        source, home = _as_table(spec), Path(".")
    replaced = {other for pair in _EITHER if pair & set(card) for other in pair}
    source = {key: value for key, value in source.items() if key not in replaced} | dict(card)
    source = {**source, "camera": [dict(row) for row in source.get("camera", [])]}
    for number, keys in cameras.items():
        if number < len(source["camera"]):
            row = {k: v for k, v in source["camera"][number].items() if k not in _replaced_keys(keys)}
            source["camera"][number] = {**row, **keys}
    measured = any(tuple(light.intensity) != _UNMEASURED for light in lights.values() if light)
    rows = []
    for number, row in enumerate(source["observation"]):
        space = spec.observations[number].image.colour_space
        if space != row.get("colour_space", source.get("colour_space", "auto")):  # the caller's overrides the file's
            row = {**row, "colour_space": space}
        if number not in lights:
            rows.append(row)
        elif (light := lights[number]) is not None:
            kept = {k: v for k, v in row.items() if k not in _LIGHT_KEYS}
            same_unit = light.distant == ("light_position" not in row)  # a near lamp's is at distance 1
            former = row.get("light_intensity") if same_unit else None
            rows.append({**kept, **_light_keys(light, list(light.intensity) if measured else former)})
    source["observation"] = rows
    return "\n".join(_lines(_rebased(source, home, folder))) + "\n"


def _light_keys(light: Light, intensity: Any) -> dict[str, Any]:
    keys = {"light_direction" if light.distant else "light_position": list(light.vector)}
    return keys if intensity is None else {**keys, "light_intensity": intensity}


def _as_table(spec: CaptureSpec) -> dict[str, Any]:
    """Return the capture.toml table of a spec from another format, with its paths unchanged."""
    camera: dict[str, Any] = {"name": spec.views[0].name}
    file = (spec.source if spec.source.is_dir() else spec.source.parent) / CAMERA
    if file.exists() and spec.kind is not CaptureKind.RTI:
        camera |= camera_keys(file)
    if spec.views[0].mask is not None:
        camera["mask"] = str(spec.views[0].mask.path)
    rows = []
    for observation in spec.observations:
        row: dict[str, Any] = {"name": observation.name, "image": str(observation.image.path)}
        if observation.image.colour_space != "auto":
            row["colour_space"] = observation.image.colour_space
        if spec.kind is not CaptureKind.IMAGES and tuple(observation.intensity) != _UNMEASURED:
            row["light_intensity"] = list(observation.intensity)
        rows.append(row)
    return {"format": table.FORMAT, "name": spec.name, "camera": [camera], "observation": rows}


def _rebased(value: Any, home: Path, folder: Path) -> Any:
    """Return a table with its image paths rebased from ``home`` to ``folder``."""
    if isinstance(value, list):
        return [_rebased(item, home, folder) for item in value]
    if not isinstance(value, dict):
        return value
    rebased = {}
    for key, item in value.items():
        if key in _PATH_KEYS and isinstance(item, str):
            rebased[key] = relative_path(home / item, folder)
        else:
            rebased[key] = _rebased(item, home, folder) if key in ("camera", "observation") else item
    return rebased


def relative_path(path: Path, folder: Path) -> str:
    """Return a path relative to ``folder``, or absolute where it is on another drive."""
    try:
        return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()
    except ValueError:
        return path.resolve().as_posix()


def _lines(source: Mapping[str, Any]) -> Iterator[str]:
    for key, value in source.items():
        if key not in ("camera", "observation"):
            yield f"{key} = {toml_value(value)}"
    for kind in ("camera", "observation"):
        for row in source.get(kind, []):
            yield from ["", f"[[{kind}]]"]
            yield from (f"{key} = {toml_value(value)}" for key, value in row.items())
