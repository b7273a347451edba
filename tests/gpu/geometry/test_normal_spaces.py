"""Recovered world normals through a written normal map into Cycles' normal pass, on a mesh hard to get right."""

import bpy
import numpy as np
import pytest
from mathutils import Euler, Matrix, Vector

from irpso_addon.blender.materials import tangent_frames as frames
from irpso_addon.blender.materials.material import apply_material, build_material
from irpso_addon.blender.mesh import extract_mesh
from irpso_addon.blender.scenes import scene
from irpso_addon.core.png import encode_png
from irpso_addon.geometry import spaces
from irpso_addon.geometry.surface import bake
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.derived_map import normal_maps
from irpso_addon.results.maps import Maps
from tests.builders.command_line import angle
from tests.builders.domains import unit
from tests.oracles.cycles_passes import normals_of, rendered_passes

TEXELS, PIXELS = 512, 128
SCALE, TURN = (1.5, 0.8, -1.2), (0.4, -0.3, 0.7)
HALF = 16  # quads along the ridge of the mesh, 8 across each slope


def roof():
    """A bent sheet with a sharp crease along its middle, whose left side lies mirrored and turned in the UV square."""
    columns = rows = HALF
    u, v = np.meshgrid(np.linspace(-1, 1, columns + 1), np.linspace(-1, 1, rows + 1))
    height = 0.35 * np.cos(1.6 * u) + 0.15 * np.sin(2.2 * v + u) - 0.4 * np.abs(u)
    points = np.stack([u, v, height], axis=-1).reshape(-1, 3)
    corner = np.arange(rows * (columns + 1)).reshape(rows, columns + 1)[:, :-1].ravel()
    faces = np.stack([corner, corner + 1, corner + columns + 2, corner + columns + 1], axis=-1)
    mesh = bpy.data.meshes.new("roof")
    mesh.from_pydata(points.tolist(), [], faces.tolist())
    mesh.polygons.foreach_set("use_smooth", np.ones(len(faces), bool))
    edges = np.array([edge.vertices[:] for edge in mesh.edges])
    crease = (points[edges][..., 0] == 0).all(axis=-1)
    sharp = mesh.attributes.new("sharp_edge", "BOOLEAN", "EDGE")
    sharp.data.foreach_set("value", crease)
    layer = mesh.uv_layers.new(name="UVMap")
    across, along = points[faces][..., 0], points[faces][..., 1]  # (F, 4)
    left = across.mean(axis=1) < 0
    placed = np.stack([0.55 + 0.4 * across, 0.5 + 0.45 * along], axis=-1)
    c, s = np.cos(np.radians(20)), np.sin(np.radians(20))
    # The left side is mirrored, turned by 20°, and smaller.
    mirrored = np.stack([-0.28 * across, 0.4 * along], axis=-1) @ np.array([[c, s], [-s, c]])
    mirrored = mirrored * 0.9 + (0.15, 0.45)
    uvs = np.where(left[:, None, None], mirrored, placed)
    layer.uv.foreach_set("vector", uvs.ravel().astype(np.float32))
    obj = bpy.data.objects.new("roof", mesh)
    obj.scale, obj.rotation_euler, obj.location = SCALE, Euler(TURN), (0.2, -0.1, 0.3)
    bpy.context.scene.collection.objects.link(obj)
    bpy.context.view_layer.update()
    return obj


def wanted_normals(position, normal):
    """World normals that lean off the surface's own by up to 30° and change slowly over space."""
    x, y, z = np.moveaxis(np.asarray(position, np.float64), -1, 0)
    lean = 0.35 * np.stack([np.sin(2 * x + y), np.cos(1.5 * y - z), np.sin(1.7 * z + x)], axis=-1)
    return unit(normal + lean)


def view_of(obj):
    """A camera that sees the whole sheet from above and aside."""
    data = bpy.data.cameras.new("view")
    data.type, data.ortho_scale = "ORTHO", 4.2
    view = bpy.data.objects.new("view", data)
    up = obj.matrix_world.to_3x3().inverted().transposed() @ Vector((0.15, -0.2, 1))
    turn = up.normalized().to_track_quat("Z", "Y").to_matrix().to_4x4()
    view.matrix_world = Matrix.Translation(obj.matrix_world.translation + 6 * up.normalized()) @ turn
    bpy.context.scene.collection.objects.link(view)
    bpy.context.scene.camera = view
    bpy.context.view_layer.update()
    return view


def normal_pass(path):
    """Return (PIXELS, PIXELS, 3): the normal pass that Cycles writes, at the pixels' centres, row 0 at the bottom."""
    return normals_of(rendered_passes(path, PIXELS))


@pytest.fixture(scope="module")
def subject(tmp_path_factory):
    """Object, mesh, texels, what its pixels show, the material with the map in it, and a folder."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    obj = roof()
    mesh = extract_mesh(obj)
    texels = bake.bake_uv(mesh, TEXELS, TEXELS)
    wanted = wanted_normals(texels.position, texels.normal)
    solver = np.einsum("hwij,hwj->hwi", texels.frames(), wanted)
    values = {"base_color": np.full((TEXELS, TEXELS, 3), 0.5, np.float32)}
    values["normal"] = frames.to_blender(mesh, texels, solver)
    material = build_material(Maps(load_model("lambert"), values, texels.coverage), "roof")
    apply_material(obj, material)
    seen = bake.bake_camera(mesh, scene.camera_from_object(view_of(obj), PIXELS, PIXELS))
    return obj, mesh, texels, solver, seen, material, tmp_path_factory.mktemp("spaces")


def kinds_of(seen, obj):
    """Return name → (H, W) bool: pixels that Cycles and the bake are both sure of, by where they lie."""
    backward = np.array(bpy.context.scene.camera.matrix_world)[:3, 2]
    local = (seen.position - np.array(obj.location)) @ np.array(Euler(TURN).to_matrix()) / np.array(SCALE)
    inner = (np.abs(local[..., :2]) < 0.97).all(axis=-1) & (np.abs(local[..., 0]) > 0.03)
    sure = seen.coverage & inner & (seen.face_normal @ backward > 0.25)
    crease = np.abs(local[..., 0]) < 0.2
    left = local[..., 0] < 0
    return {
        "smooth, as drawn": sure & ~left & ~crease, "smooth, mirrored": sure & left & ~crease,
        "beside the crease, as drawn": sure & ~left & crease, "beside the crease, mirrored": sure & left & crease,
    }  # fmt: skip


def errors(subject, path):
    obj, _, _, _, seen, _, _ = subject
    rendered = normal_pass(path)
    error = angle(unit(np.where(seen.coverage[..., None], rendered, 1)), wanted_normals(seen.position, seen.normal))
    return {kind: error[pixels] for kind, pixels in kinds_of(seen, obj).items()}


def show(title, found):
    for kind, error in found.items():
        median, high = np.percentile(error, (50, 99))
        print(f"{title:10} {kind:28} {error.size:6} pixels, median {median:.4f}°, 99 % {high:.4f}°")


def test_the_normal_map_gives_the_recovered_world_normals_in_cycles(subject):
    found = errors(subject, subject[-1] / "tangent.exr")
    show("tangent", found)
    for error in found.values():
        assert error.size > 150 and np.median(error) < 0.02 and np.percentile(error, 99) < 0.1


def show_map(subject, extra, space):
    """Have the material read a written map in a space; a DirectX one gets its green turned over by nodes."""
    _, _, _, _, _, material, folder = subject
    encode_png(folder / f"{extra.name}.png", extra.encoded)
    image = bpy.data.images.load(str(folder / f"{extra.name}.png"))
    image.colorspace_settings.name = "Non-Color"
    tree = material.node_tree
    texture, node = tree.nodes["IRPSO map normal"], tree.nodes["IRPSO normal normal"]
    texture.image, node.space = image, space
    tree.links.new(texture.outputs["Color"], node.inputs["Color"])
    if extra.name == "normal_directx":
        turn = tree.nodes.new("ShaderNodeVectorMath")
        turn.operation = "MULTIPLY_ADD"
        turn.inputs[1].default_value, turn.inputs[2].default_value = (1, -1, 1), (0, 1, 0)
        tree.links.new(texture.outputs["Color"], turn.inputs[0])
        tree.links.new(turn.outputs["Vector"], node.inputs["Color"])


@pytest.mark.parametrize(("name", "space"), [("object", "OBJECT"), ("world", "WORLD"), ("directx", "TANGENT")])
def test_a_map_of_another_space_gives_the_same_world_normals(subject, name, space):
    _, mesh, texels, solver, _, material, folder = subject
    world = spaces.world_normals(texels, solver)
    vectors = {
        "world": world,
        "object": spaces.object_normals(mesh.matrix, world),
        "directx": frames.to_blender(mesh, texels, solver),
    }[name]
    (extra,) = normal_maps({name: vectors}, texels.coverage)
    show_map(subject, extra, space)
    found = errors(subject, folder / f"{name}.exr")
    show(name, found)
    for error in found.values():
        assert np.median(error) < 0.02 and np.percentile(error, 99) < 0.1


def test_blenders_own_object_space_turns_y_and_z_over(subject):
    _, mesh, texels, solver, _, _, folder = subject
    vectors = spaces.object_normals(mesh.matrix, spaces.world_normals(texels, solver)) * np.float32([1, -1, -1])
    (extra,) = normal_maps({"object": vectors}, texels.coverage)
    show_map(subject, extra, "BLENDER_OBJECT")
    for error in errors(subject, folder / "blender_object.exr").values():
        assert np.median(error) < 0.02 and np.percentile(error, 99) < 0.1
