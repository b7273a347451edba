"""Results for the tests of exports, and independent readers of the written files."""

import json
import struct

import bpy
import numpy as np
from mathutils import Matrix

from irpso_addon.blender.images import decode
from irpso_addon.blender.materials import tangent_frames as frames
from irpso_addon.blender.materials.material import apply_material, build_material
from irpso_addon.blender.mesh import extract_mesh
from irpso_addon.exports.result import Result
from irpso_addon.geometry.surface import bake
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.maps import Maps
from tests.builders import command_line as cli_maker
from tests.oracles import reflectance as oracles

SHAPE = (20, 28)
RANGES = {
    "lambert": {},
    "principled": {"roughness": (0.3, 0.7), "specular": (0.2, 0.9)},
    "metallic_roughness": {"roughness": (0.5, 0.7), "specular": (0.5, 0.5), "metallic": (0.1, 0.9)},
    "cook_torrance_two_lobe": {"r1": (0.1, 0.2), "r2": (0.3, 0.5), "w": (0.3, 0.8)},
}


def result_of(name, shape=SHAPE, tilt=25.0, covered=None, tiles=(1001,)):
    """Return maps of a shipped model as a result, every component a smooth wave."""
    values = cli_maker.smooth_maps(shape, RANGES[name], seed=2, tilt=tilt)
    values = {key: np.float32(value).reshape(*shape, -1) for key, value in values.items()}
    covered = np.ones(shape, bool) if covered is None else covered
    return Result("leaf", Maps(load_model(name), values, covered, tiles=tiles))


def picture(path):
    """Return (H, W, C) code values 0…1 of a PNG as Blender reads it, row 0 at the bottom."""
    return decode(path).values


def srgb(linear):
    """IEC 61966-2-1."""
    linear = np.clip(linear, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)


def unsrgb(code):
    return np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)


def read_glb(path):
    """Return the JSON of a .glb and its binary chunk, by the glTF 2.0 specification, section 4."""
    data = path.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    size, kind = struct.unpack_from("<I4s", data, 12)
    assert kind == b"JSON"
    table = json.loads(data[20 : 20 + size])
    binary, kind = struct.unpack_from("<I4s", data, 20 + size)
    assert kind == b"BIN\0"
    return table, data[28 + size : 28 + size + binary]


def accessor(table, binary, index):
    """Return (count, components) of an accessor."""
    entry = table["accessors"][index]
    view = table["bufferViews"][entry["bufferView"]]
    kind = {5123: np.uint16, 5125: np.uint32, 5126: np.float32}[entry["componentType"]]
    count = entry["count"] * {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[entry["type"]]
    start = view.get("byteOffset", 0) + entry.get("byteOffset", 0)
    return np.frombuffer(binary, kind, count, start).reshape(entry["count"], -1)


def image_of(table, binary, texture, folder):
    """Return the code values of the image of a texture reference."""
    view = table["bufferViews"][table["images"][table["textures"][texture["index"]]["source"]]["bufferView"]]
    start = view.get("byteOffset", 0)
    path = folder / f"image{texture['index']}.png"
    path.write_bytes(binary[start : start + view["byteLength"]])
    return picture(path)


def bent_sheet(size=1.0, mirrored=False, smooth=True):
    """Return a mesh of 6 × 6 non-planar quads, the left half mirrored in the UV map, with a rotation and a place.

    mirrored: by the object's scale.
    """
    u, v = np.meshgrid(np.linspace(-1, 1, 7), np.linspace(-1, 1, 7))
    points = np.stack([u, v, 0.3 * np.cos(1.5 * u) + 0.2 * np.sin(2 * v)], axis=-1).reshape(-1, 3) * size
    corner = np.arange(42).reshape(6, 7)[:, :-1].ravel()
    faces = np.stack([corner, corner + 1, corner + 8, corner + 7], axis=-1)
    mesh = bpy.data.meshes.new("sheet")
    mesh.from_pydata(points.tolist(), [], faces.tolist())
    mesh.polygons.foreach_set("use_smooth", np.full(len(faces), smooth))
    x, y = points[faces][..., 0] / size, points[faces][..., 1] / size
    left = x.mean(axis=1, keepdims=True) < 0
    flat = np.stack([np.where(left, -0.45 * x + 0.03, 0.52 + 0.45 * x), 0.5 + 0.45 * y], axis=-1)
    mesh.uv_layers.new(name="UVMap").uv.foreach_set("vector", flat.ravel().astype(np.float32))
    obj = bpy.data.objects.new("sheet", mesh)
    obj.matrix_world = Matrix.Translation((1, 2, 3)) @ Matrix.Rotation(0.7, 4, "X") @ Matrix.Scale(1.5, 4)
    obj.matrix_world = obj.matrix_world @ Matrix.Diagonal((-1 if mirrored else 1, 1, 1, 1))
    bpy.context.scene.collection.objects.link(obj)
    bpy.context.view_layer.update()
    return obj


def on_a_sheet(name, texels=192, **shape):
    """Return a result on a bent sheet whose normals tilt by the world field ``lean``, and the sheet's object."""
    obj = bent_sheet(**shape)
    mesh = extract_mesh(obj)
    surface = bake.bake_uv(mesh, texels, texels)
    values = cli_maker.smooth_maps((texels, texels), RANGES[name], seed=2)
    values = {key: np.float32(value).reshape(texels, texels, -1) for key, value in values.items()}
    wanted = oracles.unit(surface.normal + lean(surface.position))
    values["normal"] = frames.to_blender(mesh, surface, np.einsum("hwij,hwj->hwi", surface.frames(), wanted))
    result = Result("leaf", Maps(load_model(name), values, surface.coverage))
    apply_material(obj, build_material(result.maps, "leaf"))
    return result, obj


def lean(position):
    x, y, z = np.moveaxis(np.asarray(position, np.float64), -1, 0)
    return 0.4 * np.stack([np.sin(2 * x + y), np.cos(1.5 * y - z), np.sin(z + x)], axis=-1)
