"""Objects that stand beside a mesh: what they hide from lights, cameras and the mesh itself, against geometry."""

import itertools
import math
from dataclasses import replace

import bpy
import numpy as np
import pytest

from irpso_addon.blender import occluders
from irpso_addon.blender.mesh import extract_mesh
from irpso_addon.blender.occluders import named_occluders, with_occluders
from irpso_addon.blender.ray_caster import ray_caster
from irpso_addon.capture.camera import Camera
from irpso_addon.capture.types import Light
from irpso_addon.core.errors import InputError
from irpso_addon.core.steps import run_steps
from irpso_addon.geometry.light import shadows
from irpso_addon.geometry.light.light_transport import light_transport_steps
from irpso_addon.geometry.project import Projector
from irpso_addon.geometry.surface import bake
from tests.builders.cavity import cavity_mesh
from tests.oracles import geometry as oracle

BALL, RADIUS = np.array([0.1, -0.05, 0.45]), 0.3
SIZE = (64, 64)
TABLE, GROUND = (oracle.plane(width, z=-1.0, columns=1, rows=1).positions for width in (200.0, 2e5))


@pytest.fixture(autouse=True)
def empty_file():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def floor_under_ball(*others):
    """Return a floor of 2 × 2 with a ball above it that is not recovered."""
    ball = oracle.sphere(RADIUS, 64, 32, BALL).positions
    return replace(oracle.plane(2.0, columns=1, rows=1), occluders=np.concatenate([ball, *others]))


def gap_to_ball(points, vector, distant):
    """Return how far the ways from points (N, 3) to a place, or along a direction, pass the ball by; below 0 hidden."""
    toward = np.broadcast_to(vector, points.shape) if distant else vector - points
    unit = oracle.unit(toward)
    along = ((BALL - points) * unit).sum(-1)
    end = np.inf if distant else np.linalg.norm(toward, axis=-1)
    return np.linalg.norm(points + np.clip(along, 0, end)[..., None] * unit - BALL, axis=-1) - RADIUS


@pytest.mark.parametrize("others", [(), (TABLE,), (GROUND,)], ids=["ball", "ball and table", "ball and ground"])
@pytest.mark.parametrize(
    ("vector", "distant"), [((0.5, 0.3, 0.8), True), ((0.9, -0.8, 2.6), False), ((-0.4, 0.3, 0.7), False)]
)
def test_the_shadow_of_an_occluder_is_where_geometry_has_it_however_large_the_rest_is(vector, distant, others):
    mesh = floor_under_ball(*others)
    texels = bake.bake_uv(mesh, *SIZE)
    vector = oracle.unit(np.array(vector)) if distant else np.array(vector)
    caster = shadows.ShadowCaster(mesh, texels, shadows.texel_size(mesh, texels))
    weights = caster.weights(Light(tuple(vector), distant=distant), np.arange(SIZE[0] * SIZE[1]))
    gap = gap_to_ball(texels.position.reshape(-1, 3).astype(np.float64), vector, distant)
    border = 2 * 2.0 / SIZE[0]  # two texels
    assert (gap < -border).sum() > 80 and (gap > border).sum() > 2000
    assert (weights[gap < -border] == 0).all() and (weights[gap > border] == 1).all()


def test_a_low_plate_shades_the_floor_beside_a_large_ground():
    plate = oracle.plane(0.5, z=0.02, columns=1, rows=1).positions
    mesh = replace(oracle.plane(2.0, columns=1, rows=1), occluders=np.concatenate([plate, GROUND]))
    texels = bake.bake_uv(mesh, *SIZE)
    caster = shadows.ShadowCaster(mesh, texels, shadows.texel_size(mesh, texels))
    weights = caster.weights(Light((0.0, 0.0, 1.0)), np.arange(SIZE[0] * SIZE[1]))
    edge = 0.25 - np.abs(texels.position[..., :2]).max(axis=-1).ravel()  # above 0 below the plate
    border = 2 * 2.0 / SIZE[0]  # two texels
    assert (edge > border).sum() > 100
    assert (weights[edge > border] == 0).all() and (weights[edge < -border] == 1).all()


@pytest.mark.parametrize("ground", [TABLE, GROUND], ids=["table", "ground"])
@pytest.mark.parametrize("slant", [0.0, 0.3])  # seen at a slant, the ground reaches far beyond the subject
def test_a_camera_sees_nothing_behind_an_occluder(ground, slant):
    mesh = floor_under_ball(ground)
    place = np.array([0.3, 0.2 - 4 * slant, 4.0])
    matrix = np.eye(4)
    back = oracle.unit(np.array([0.0, -slant, 1.0]))
    matrix[:3, :3] = np.stack([(1, 0, 0), np.cross(back, (1, 0, 0)), back], axis=1)
    matrix[:3, 3] = place
    camera = Camera.from_fov(160, 160, 40, matrix)
    texels = bake.bake_uv(mesh, *SIZE)
    seen = bake.bake_camera(mesh, camera)
    visible = Projector(texels, seen, camera).visible.ravel()
    points = texels.position.reshape(-1, 3).astype(np.float64)
    gap = gap_to_ball(points, place, distant=False)
    where, _ = camera.project(points)
    inside = ((where > 2) & (where < 158)).all(axis=-1) & (np.abs(points[:, :2]) < 0.95).all(axis=-1)
    border = 2 * 2.0 / SIZE[0]
    assert (gap < -border).sum() > 80 and inside.sum() > 1500
    assert not visible[gap < -border].any() and visible[inside & (gap > border)].all()


def test_an_occluder_blocks_light_and_what_a_hollow_sphere_sends_itself():
    # The form factor of a ball of radius r from the wall of a sphere of radius 1 around it: r².
    radius, light = 0.4, np.float32([[0.1, 0.2, -0.7, 1]])
    bare = cavity_mesh()
    mesh = replace(bare, occluders=oracle.sphere(radius, 96, 48).positions)
    surface = bake.bake_uv(mesh, 48, 24, allow_overlap=True)
    transport = run_steps(light_transport_steps(mesh, surface, light, ray_caster(mesh), 48, 256))
    np.testing.assert_allclose((transport.hits < 0).mean(), radius**2, rtol=0.02)
    places = surface.position.reshape(-1, 3)[transport.texels].astype(np.float64)
    away = light[0, :3].astype(np.float64) - places
    along = np.clip(-(places * away).sum(axis=-1) / (away**2).sum(axis=-1), 0, 1)
    passing = np.linalg.norm(places + along[:, None] * away, axis=-1) - radius
    assert (passing < 0).mean() > 0.1
    clear = np.abs(passing) > 0.03
    np.testing.assert_array_equal(transport.lit[0, clear], passing[clear] > 0)


def test_occluders_are_evaluated_objects_in_the_world():
    bpy.ops.mesh.primitive_plane_add()
    subject = bpy.context.object
    bpy.ops.mesh.primitive_cube_add(size=2, location=(1, 2, 3), rotation=(0, 0, math.pi / 4))
    bpy.context.object.modifiers.new("subdivision", "SUBSURF").subdivision_type = "SIMPLE"
    bpy.ops.curve.primitive_bezier_circle_add(location=(0, 0, -5))
    bpy.context.object.name, bpy.context.object.data.bevel_depth = "Ring", 0.25
    names = ["Cube", "Ring", "Cube"]
    mesh = with_occluders(extract_mesh(subject), named_occluders(names, subject, "--occluder"))
    assert len(mesh.positions) == 2 and mesh.opaque.shape == (2 + len(mesh.occluders), 3, 3)
    cube = mesh.occluders[:48].reshape(-1, 3)  # 6 faces, each 4 quads
    np.testing.assert_allclose(cube.min(axis=0), (1 - math.sqrt(2), 2 - math.sqrt(2), 2), atol=1e-5)
    np.testing.assert_allclose(cube.max(axis=0), (1 + math.sqrt(2), 2 + math.sqrt(2), 4), atol=1e-5)
    ring = mesh.occluders[48:].reshape(-1, 3)
    np.testing.assert_allclose((ring[:, 2].min(), ring[:, 2].max()), (-5.25, -4.75), atol=1e-3)
    assert len(mesh.occluders) > 48 and mesh.occluders.dtype == np.float32


def block(name, collection):
    """Return a new cube of side 2 in a collection."""
    bpy.ops.mesh.primitive_cube_add(size=2)
    obj = bpy.context.object
    obj.name = name
    obj.users_collection[0].objects.unlink(obj)
    collection.objects.link(obj)
    return obj


def collection_instance(block_of, collection):
    """An empty that shows a collection, which shows another, which has the block 10 along x."""
    inner, outer = bpy.data.collections.new("inner"), bpy.data.collections.new("outer")
    block_of(inner).location.x = 10
    for shown, holder in ((inner, outer), (outer, collection)):
        empty = bpy.data.objects.new("Shows", None)
        empty.instance_type, empty.instance_collection = "COLLECTION", shown
        holder.objects.link(empty)


def vertex_instances(block_of, collection):
    """Two vertices 9 and 11 along x, with a block on each."""
    mesh = bpy.data.meshes.new("points")
    mesh.from_pydata([(9, 0, 0), (11, 0, 0)], [], [])
    holder = bpy.data.objects.new("Holder", mesh)
    collection.objects.link(holder)
    block_of(bpy.context.scene.collection).parent = holder
    holder.instance_type = "VERTS"


def node_instances(block_of, collection):
    """The same by geometry nodes."""
    mesh = bpy.data.meshes.new("points")
    mesh.from_pydata([(9, 0, 0), (11, 0, 0)], [], [])
    holder = bpy.data.objects.new("Holder", mesh)
    collection.objects.link(holder)
    tree = bpy.data.node_groups.new("scatter", "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    kinds = ("NodeGroupInput", "GeometryNodeMeshToPoints", "GeometryNodeInstanceOnPoints", "NodeGroupOutput")
    nodes = [tree.nodes.new(kind) for kind in kinds]
    for first, second in itertools.pairwise(nodes):
        tree.links.new(first.outputs[0], second.inputs[0])
    source = tree.nodes.new("GeometryNodeObjectInfo")
    source.inputs["Object"].default_value = block_of(bpy.context.scene.collection)
    tree.links.new(source.outputs["Geometry"], nodes[2].inputs["Instance"])
    holder.modifiers.new("scatter", "NODES").node_group = tree


@pytest.mark.parametrize(
    ("instance", "blocks", "reach"),
    [(collection_instance, 1, (9, 11)), (vertex_instances, 2, (8, 12)), (node_instances, 2, (8, 12))],
)
def test_instances_occlude_where_the_viewport_shows_them(instance, blocks, reach):
    bpy.ops.mesh.primitive_plane_add()
    subject, collection = bpy.context.object, bpy.data.collections.new("around")
    bpy.context.scene.collection.children.link(collection)
    instance(lambda holder: block("Block", holder), collection)
    bpy.context.view_layer.update()
    before = len(bpy.data.meshes)
    names = [obj.name for obj in collection.objects]
    found = with_occluders(extract_mesh(subject), named_occluders(names, subject, "--occluder")).occluders
    assert found.shape == (12 * blocks, 3, 3) and len(bpy.data.meshes) == before
    np.testing.assert_allclose((found[..., 0].min(), found[..., 0].max()), reach, atol=1e-6)
    np.testing.assert_allclose((found[..., 1:].min(), found[..., 1:].max()), (-1, 1), atol=1e-6)


def test_what_cannot_occlude_is_refused_by_name():
    bpy.ops.mesh.primitive_plane_add()
    subject = bpy.context.object
    mesh = extract_mesh(subject)
    with pytest.raises(InputError, match=r"--occluder Table: there is no such object in scene 'Scene'"):
        named_occluders(["Table"], subject, "--occluder")
    with pytest.raises(InputError, match="--occluder Plane: is the mesh that is recovered"):
        named_occluders(["Plane"], subject, "--occluder")
    bpy.ops.object.light_add()
    with pytest.raises(InputError, match="occluder 'Point' is of type LIGHT, which has no surface"):
        with_occluders(mesh, [bpy.context.object])
    empty = bpy.data.objects.new("Dust", bpy.data.meshes.new("Dust"))
    bpy.context.scene.collection.objects.link(empty)
    with pytest.raises(InputError, match="occluder 'Dust' has no faces"):
        with_occluders(mesh, [empty])
    bpy.ops.mesh.primitive_cube_add()
    bpy.context.object.hide_viewport = True
    bpy.context.view_layer.update()
    with pytest.raises(InputError, match="occluder 'Cube' is not in the active view layer or is hidden"):
        with_occluders(mesh, [bpy.data.objects["Cube"]])
    assert with_occluders(mesh, []) is mesh


def test_without_occluders_no_instance_is_looked_at(monkeypatch):
    bpy.ops.mesh.primitive_plane_add()
    mesh = extract_mesh(bpy.context.object)
    monkeypatch.setattr(occluders, "_instances", None)
    assert with_occluders(mesh, []) is mesh


def test_an_instance_of_lights_alone_is_left_out_of_a_collection_and_refused_by_name():
    bpy.ops.mesh.primitive_plane_add()
    mesh = extract_mesh(bpy.context.object)
    lamps = bpy.data.collections.new("lamps")
    lamps.objects.link(bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT")))
    empty = bpy.data.objects.new("Lights", None)
    bpy.context.scene.collection.objects.link(empty)
    empty.instance_type, empty.instance_collection = "COLLECTION", lamps
    bpy.ops.mesh.primitive_cube_add()
    cube = bpy.context.object
    bpy.context.view_layer.update()
    with pytest.raises(InputError, match="occluder 'Lights' has no faces"):
        with_occluders(mesh, [cube, empty])
    assert with_occluders(mesh, [cube, empty], of_collection=True).occluders.shape == (12, 3, 3)
    assert with_occluders(mesh, [empty], of_collection=True).occluders.shape == (0, 3, 3)
