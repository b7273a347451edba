"""Reads cameras of Agisoft Metashape from the XML of File > Export > Export Cameras.

Metashape's user manual, appendix "Camera models", frame cameras: x right, y down, z along the view, r² = x² + y²,
x′ = x (1 + K1 r² + K2 r⁴ + K3 r⁶ + K4 r⁸) + (P1 (r² + 2x²) + 2 P2 xy)(1 + P3 r² + P4 r⁴), y′ likewise with P1 and P2
exchanged (its P1 is OpenCV's p2), u = w/2 + cx + x′ f + x′ B1 + y′ B2, v = h/2 + cy + y′ f; the upper
left pixel's centre is (0.5, 0.5).
"""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np

from ..camera import Camera, is_rotation
from ..errors import CaptureError
from .posed import Lens, PoseFile, camera_from_vision, similarity, stated_orientation

_AGAIN = "export the cameras again (File > Export > Export Cameras, Agisoft XML)"
_NEGLIGIBLE = 0.1  # pixels at the image's corners: largest ignored effect of an unsupported term
_NO = ("0", "false")
_TERMS = ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4")
_EARTH = ("GEOGCS", "GEOCCS", "PROJCS", "GEODCRS", "PROJCRS", "COMPD_CS")  # WKT keywords of systems on the Earth


def read_metashape(path: Path) -> PoseFile:
    """Return the cameras of a Metashape XML file in the world of its exported models (scale of the chunk applied).

    Disabled and unaligned cameras are unusable, those of other components than the active one, and slave cameras of
    multi-camera systems: the file gives only their sensor's offset from the master camera. Raises CaptureError if the
    file is damaged, or its world is a map of the Earth.
    """
    root = _parsed(path)
    chunks = [root] if root.tag == "chunk" else root.findall("chunk")
    if len(chunks) != 1:
        what = f"holds {len(chunks)} chunks; export one" if chunks else f"is no list of Metashape's cameras; {_AGAIN}"
        raise CaptureError(f"{path}: {what}", "kind")
    (chunk,) = chunks
    if (chunk.findtext("reference") or "").strip().startswith(_EARTH):
        raise CaptureError(
            f"{path}: its cameras have geographic coordinates; in Metashape's Reference pane choose Local"
            " Coordinates, then export the cameras and the model again",
            "camera",
        )
    sensors = {sensor.get("id"): sensor for sensor in chunk.iterfind("sensors/sensor")}
    places = {part.get("id"): part.find("transform") for part in chunk.iterfind("components/component")}
    others = _other_components(chunk.find("components"))
    cameras: dict[str, Camera] = {}
    unusable: dict[str, str] = {}
    orientations: dict[str, int] = {}
    for element in chunk.iterfind("cameras//camera"):
        name = element.get("label") or f"camera {element.get('id')}"
        where = f"{path}: camera '{name}'"
        if name in cameras or name in unusable:
            cameras.pop(name, None)
            unusable[name] = "is the name of several photographs; give them different labels in Metashape"
        elif why := _why_unusable(element, others):
            unusable[name] = why
        else:
            sensor = sensors.get(element.get("sensor_id"))
            if sensor is None:
                raise CaptureError(f"{where}: its sensor {element.get('sensor_id')} is not there; {_AGAIN}", "camera")
            lens = _lens(sensor, f"{path}: sensor '{sensor.get('label', sensor.get('id'))}'")
            place = places.get(element.get("component_id"))
            world = _transform(chunk.find("transform") if place is None else place, f"{path}: the chunk's transform")
            if isinstance(lens, str):
                unusable[name] = lens
            else:
                cameras[name] = camera_from_vision(*lens, *_pose(element, world, where))
                orientations |= stated_orientation(name, element.findtext("orientation"))
    return PoseFile(path, "Metashape", cameras, unusable, orientations)


def _other_components(components: ElementTree.Element | None) -> set[str | None]:
    """Return the numbers of the components that share no world with the model.

    An alignment in parts without common points makes several components. The model is that of the active one. Without
    a stated one, a component that has no transform lies elsewhere than those that have one.
    """
    parts = {} if components is None else {part.get("id"): part for part in components.iterfind("component")}
    active = None if components is None else components.get("active_id")
    if active in parts:
        return parts.keys() - {active}
    placed = {number for number, part in parts.items() if part.find("transform") is not None}
    return parts.keys() - placed if placed else set()


def _why_unusable(element: ElementTree.Element, other_components: set[str | None]) -> str:
    """Return the reason why a camera has no usable pose, "" for none."""
    if (element.get("enabled") or "true").lower() in _NO:
        return "is disabled; enable it in Metashape and export again"
    if element.find("transform") is None and "master_id" in element.attrib:
        return (
            "is a slave camera of a multi-camera system, whose poses are not read; add the photographs to Metashape"
            " as single cameras, align them, and export again"
        )
    if element.find("transform") is None:
        return "was not aligned; align it in Metashape and export again"
    if element.get("component_id") in other_components:
        return (
            "was aligned in another component than the model's, with a place and scale of its own; in Metashape align"
            " or merge the components, or make its component the active one, and export cameras and model again"
        )
    return ""


def _parsed(path: Path) -> ElementTree.Element:
    """Return the root of an XML file without a document type: entities could grow without bound or open other files."""
    data = path.read_bytes()

    def refuse(*_: object) -> None:
        raise CaptureError(f"{path}: declares a document type, which Metashape's files do not; {_AGAIN}", "kind")

    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(data, True)
        return ElementTree.fromstring(data)
    except (expat.ExpatError, ElementTree.ParseError) as error:
        raise CaptureError(f"{path}: is cut short or no XML ({error}); {_AGAIN}", "not_text") from error
    except (ValueError, LookupError) as error:  # of the declared encoding
        raise CaptureError(
            f"{path}: has an encoding that is not read ({error}); save it as UTF-8", "not_text"
        ) from error


def _lens(sensor: ElementTree.Element, where: str) -> Lens | str:
    """Return (size, focal length, centre, distortion), or the reason why the sensor is unsupported."""
    items = sensor.findall("calibration")
    calibration = next((item for item in items if item.get("class") == "adjusted"), items[0] if items else None)
    kind = sensor.get("type") if calibration is None else calibration.get("type") or sensor.get("type")
    if kind and kind != "frame":
        return f"has a lens of type {kind}; only frame cameras are read: export undistorted photographs from Metashape"
    if calibration is None:
        return "has a sensor without a calibration; align its photographs in Metashape and export again"
    resolution = calibration.find("resolution")
    resolution = sensor.find("resolution") if resolution is None else resolution
    if resolution is None:
        raise CaptureError(f"{where}: has no resolution; {_AGAIN}", "camera")
    size = tuple(_numbers(resolution.get(side), 1, f"{where}: its resolution")[0] for side in ("width", "height"))
    terms = {item.tag: _numbers(item.text, 1, f"{where}: {item.tag}")[0] for item in calibration if item.tag in _TERMS}
    if "f" not in terms:
        raise CaptureError(f"{where}: its calibration has no f; {_AGAIN} with Metashape 1 or later", "camera")
    if min(terms["f"], terms["f"] + terms.get("b1", 0), *size) <= 0 or any(side % 1 for side in size):
        raise CaptureError(f"{where}: resolution and f must be above 0; {_AGAIN}", "camera")
    if term := _unsupported_term(terms, size):
        return (
            f"has {term}, which is not read; optimize the alignment without it, or export undistorted photographs from"
            " Metashape"
        )
    centre = (size[0] / 2 + terms.get("cx", 0), size[1] / 2 + terms.get("cy", 0))
    distortion = tuple(terms.get(name, 0.0) for name in ("k1", "k2", "p2", "p1", "k3"))
    return (int(size[0]), int(size[1])), (terms["f"] + terms.get("b1", 0), terms["f"]), centre, distortion


def _unsupported_term(terms: dict[str, float], size: tuple[float, ...]) -> str:
    """Return the name of an unsupported term that moves the image's corners by over 0.1 pixels, "" for none."""
    x = (size[0] / 2 + abs(terms.get("cx", 0))) / terms["f"]
    y = (size[1] / 2 + abs(terms.get("cy", 0))) / terms["f"]
    r = math.hypot(x, y)
    tangential = 3 * r**2 * (abs(terms.get("p1", 0)) + abs(terms.get("p2", 0)))
    pixels = {
        "B2": abs(terms.get("b2", 0)) * y,
        "K4": abs(terms.get("k4", 0)) * r**9 * terms["f"],
        "P3 and P4": tangential * (abs(terms.get("p3", 0)) * r**2 + abs(terms.get("p4", 0)) * r**4) * terms["f"],
    }
    return next((name for name, moved in pixels.items() if moved > _NEGLIGIBLE), "")


def _transform(element: ElementTree.Element | None, where: str) -> np.ndarray:
    """Return the (4, 4) similarity from a component's coordinates to the world."""
    matrix = np.eye(4)
    if element is None:
        return matrix
    rotation, translation = element.findtext("rotation"), element.findtext("translation")
    scale = element.findtext("scale")
    if rotation is not None:
        matrix[:3, :3] = np.reshape(_numbers(rotation, 9, where), (3, 3))
    if scale is not None:
        matrix[:3, :3] *= _numbers(scale, 1, where)[0]
    if translation is not None:
        matrix[:3, 3] = _numbers(translation, 3, where)
    if rotation is None and element.text and element.text.strip():
        matrix = np.reshape(_numbers(element.text, 16, where), (4, 4))
    return similarity(matrix, where)


def _pose(element: ElementTree.Element, world: np.ndarray, where: str) -> tuple[np.ndarray, np.ndarray]:
    """Return rotation (3, 3), camera to world, and position (3,)."""
    pose = np.reshape(_numbers(element.findtext("transform"), 16, f"{where}: its transform"), (4, 4))
    if not is_rotation(pose[:3, :3]):
        raise CaptureError(f"{where}: its transform must be a rotation and a position; {_AGAIN}", "matrix")
    matrix = world @ pose
    return matrix[:3, :3] / np.cbrt(np.linalg.det(world[:3, :3])), matrix[:3, 3]


def _numbers(text: str | None, count: int, where: str) -> list[float]:
    try:
        values = [float(word) for word in (text or "").split()]
    except ValueError:
        values = []
    if len(values) != count or not np.isfinite(values).all():
        raise CaptureError(f"{where} must be {count} finite number{'s' * (count > 1)}; {_AGAIN}", "not_number")
    return values
