"""Bakes against brute-force float64 rasterisers, projections there and back, and meshes as Blender has them."""

import math
from dataclasses import replace

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Matrix, Vector

from irpso_addon.blender.materials import tangent_frames as frames
from irpso_addon.blender.mesh import extract_mesh
from irpso_addon.blender.scenes import scene
from irpso_addon.capture.camera import Camera
from irpso_addon.capture.types import Capture, Light, Observation
from irpso_addon.core.errors import InputError
from irpso_addon.geometry.build import domain_from_mesh
from irpso_addon.geometry.project import Projector
from irpso_addon.geometry.surface import bake
from irpso_addon.gpu import raster
from tests.oracles import geometry as oracle

ROUNDING = 1 / 128  # texels: hardware moves corners to a grid of 1/256, so nearer to an edge coverage is its choice


@pytest.fixture(autouse=True)
def empty_file():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def monkey(levels=0, **placing):
    bpy.ops.mesh.primitive_monkey_add()
    obj = bpy.context.object
    for name, value in placing.items():
        setattr(obj, name, value)
    if levels:
        obj.modifiers.new("subdivision", "SUBSURF").levels = levels
    bpy.context.view_layer.update()
    return obj


def looking(position, target=(0, 0, 0)):
    """Return the matrix of a camera at a position that looks at a target."""
    direction = Vector(position) - Vector(target)
    placed = Matrix.Translation(position) @ direction.to_track_quat("Z", "Y").to_matrix().to_4x4()
    return np.array(placed, np.float64)


def cameras():
    place = looking((1.5, -3.5, 1.2))
    return {
        "perspective off centre": Camera(61, 47, (70.0, 66.0), (25.3, 28.1), place),
        "orthographic": Camera(47, 61, (17.0, 19.0), (23.9, 28.0), place, False),
    }


def toward(camera, positions):
    """Return unit vectors from positions to a camera."""
    return oracle.unit(camera.position - positions) if camera.perspective else camera.backward


def assert_same_bake(drawn, expected, clear):
    """Compare where both are sure: the pixel's centre is not on an edge, where rounding chooses the triangle."""
    assert (drawn.coverage == expected.coverage)[clear].all()
    both = drawn.coverage & expected.coverage & clear
    assert both.sum() > 0.1 * both.size
    for name, tolerance in (
        ("position", 2e-5),
        ("normal", 2e-5),
        ("tangent", 2e-4),
        ("uv", 2e-5),
        ("face_normal", 1e-4),
    ):
        error = np.abs(getattr(drawn, name) - getattr(expected, name))[both].max()
        assert error < tolerance, f"{name} is off by {error}"
    assert (drawn.triangle == expected.triangle)[both].all()
    for name in ("position", "normal", "tangent", "uv"):
        assert (getattr(drawn, name)[~drawn.coverage] == 0).all()


@pytest.mark.parametrize(("width", "height"), [(64, 64), (45, 67), (1, 1), (150, 25)])
def test_a_uv_bake_agrees_with_a_float64_rasteriser_at_odd_sizes_and_across_seams(width, height):
    mesh = oracle.joined(
        oracle.sphere(columns=9, rows=7), replace(oracle.plane(), uvs=oracle.plane().uvs * 0)
    )  # a seam at longitude 0, and a part with no texels
    drawn = bake.bake_uv(mesh, width, height)
    expected, distance = oracle.bake_uv(mesh, width, height)
    if width * height == 1:
        assert drawn.coverage.all()
        return
    assert_same_bake(drawn, expected, distance > ROUNDING)


def test_mirrored_texture_coordinates_give_the_other_sign_and_the_same_normal_frame():
    right = oracle.plane(u_span=(0.5, 1.0))
    left = oracle.plane(u_span=(0.5, 0.0), z=1.0)
    flipped = left.tangents.copy() * np.float32([-1, -1, -1, -1])
    drawn = bake.bake_uv(oracle.joined(right, replace(left, tangents=flipped)), 32, 16)
    assert (drawn.tangent[:, :16] == np.float32([-1, 0, 0, -1])).all()
    assert (drawn.tangent[:, 16:] == np.float32([1, 0, 0, 1])).all()
    bitangent = drawn.tangent[..., 3:] * np.cross(drawn.normal, drawn.tangent[..., :3])
    np.testing.assert_array_equal(bitangent, np.broadcast_to([0, 1, 0], bitangent.shape))


def test_the_frame_of_every_texel_is_orthonormal():
    drawn = bake.bake_uv(extract_mesh(monkey()), 150, 225)
    n, t = drawn.normal[drawn.coverage], drawn.tangent[drawn.coverage][:, :3]
    for error in (np.linalg.norm(n, axis=1) - 1, np.linalg.norm(t, axis=1) - 1, (n * t).sum(1)):
        assert np.abs(error).max() < 1e-6


@pytest.mark.parametrize("name", ["perspective off centre", "orthographic"])
def test_a_camera_bake_agrees_with_a_float64_ray_caster(name):
    camera, mesh = cameras()[name], oracle.sphere(columns=12, rows=8)
    mesh = oracle.joined(mesh, oracle.sphere(0.3, 8, 6, (1.0, -1.2, 0.3)))
    expected, distance = oracle.bake_camera(mesh, camera)
    # Seen edge on, a surface's depth multiplies the rounding of the pixel's place.
    edge_on = expected.coverage & (np.abs((expected.face_normal * toward(camera, expected.position)).sum(-1)) < 0.2)
    assert_same_bake(bake.bake_camera(mesh, camera), expected, (distance > ROUNDING) & ~edge_on)


def test_a_surface_that_passes_behind_the_camera_is_cut_at_the_camera():
    floor = oracle.plane(40.0, columns=1, rows=1)
    camera = Camera(40, 30, (30.0, 30.0), (20.0, 15.0), looking((0, 0, 1.0), (0, 5, 0.5)))
    drawn = bake.bake_camera(floor, camera)
    expected, _ = oracle.bake_camera(floor, camera)
    assert (drawn.coverage == expected.coverage).all() and 200 < drawn.coverage.sum() < 1200
    np.testing.assert_allclose(drawn.position, expected.position, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("name", ["perspective off centre", "orthographic"])
def test_the_surface_point_of_a_pixel_projects_to_its_centre(name):
    camera = cameras()[name]
    camera = replace(
        camera, width=camera.width * 8, height=camera.height * 8,
        scale=tuple(8 * s for s in camera.scale), centre=tuple(8 * c for c in camera.centre),
    )  # fmt: skip
    drawn = bake.bake_camera(extract_mesh(monkey(2)), camera)
    y, x = np.nonzero(drawn.coverage)
    pixels, _ = camera.project(drawn.position[drawn.coverage].astype(np.float64))
    assert len(x) > 20000 and np.abs(pixels - np.stack([x + 0.5, y + 0.5], -1)).max() < 1e-3


def smooth(position):
    """Return an RGB radiance that changes slowly over space."""
    x, y, z = np.moveaxis(np.asarray(position, np.float64), -1, 0)
    return np.stack([0.6 + 0.3 * np.sin(2 * x + y), 0.5 + 0.2 * z * x, 0.4 + 0.3 * np.cos(1.5 * z - y)], -1)


def photograph(mesh, camera):
    seen = bake.bake_camera(mesh, camera)
    image = np.zeros((camera.height, camera.width, 4), np.float32)
    image[seen.coverage, :3] = smooth(seen.position[seen.coverage])
    image[..., 3] = seen.coverage
    return image


def test_radiance_from_two_sides_returns_to_its_texels():
    mesh = extract_mesh(monkey(2))
    pair = tuple(Camera.from_fov(300, 240, 40, looking((x, -3, 0.6))) for x in (-3.0, 3.0))
    images = [photograph(mesh, camera) for camera in pair]
    observations = tuple(
        Observation(f"side {k}", lambda k=k: images[k], Light((0, 0, 2), distant=False), camera=k) for k in (0, 1)
    )
    taken = Capture("two sides", observations, pair, tuple(np.ones((240, 300), bool) for _ in pair))
    domain = domain_from_mesh(taken, mesh, 150, 225, shadows=False, areas=False)
    weight = domain.stack.values[..., 3] > 0
    assert not domain.card and (weight <= domain.bake.coverage).all()
    error = np.abs(domain.stack.values[..., :3] - smooth(domain.bake.position))
    surface = bake.bake_uv(mesh, 150, 225)
    pixel = 5.0 / pair[0].scale[0]
    for k, camera in enumerate(pair):
        spacing = pixel / (toward(camera, domain.bake.position) * surface.face_normal).sum(-1)[weight[k]]
        # Bilinear, two directions: h²/8 of a second derivative of at most 1.5, for pixels h apart on the surface.
        bilinear = 2 * spacing**2 / 8 * 1.5
        # That is on a plane. Where the mesh bends, the four pixels may leave the texel's plane by half a pixel, which
        # along the view is half a spacing; the radiance's slope is at most 0.75.
        bound = bilinear + 0.75 * 0.5 * spacing
        worst = error[k].max(-1)[weight[k]]
        assert (worst < bound).all() and (worst < bilinear).mean() > 0.8
    # Each sees its own half, and the two together more than either.
    x = domain.bake.position[..., 0]
    for k, side in enumerate((-1, 1)):
        assert (side * x[weight[k]]).mean() > 0.1 and 0.15 < weight[k].sum() / domain.bake.coverage.sum() < 0.5
    assert weight.any(0).sum() > 1.2 * max(weight[0].sum(), weight[1].sum())
    np.testing.assert_allclose(domain.views, [[*camera.position, 1] for camera in pair], rtol=1e-6)
    np.testing.assert_array_equal(domain.lights, [[0, 0, 2, 1]] * 2)


def test_a_mesh_that_no_image_shows_is_refused():
    mesh, camera = oracle.plane(), Camera.from_fov(8, 8, 40, looking((0, 0, 3), (0, 0, 9)))
    image, mask = np.ones((8, 8, 4), np.float32), np.ones((8, 8), bool)
    taken = Capture("away", (Observation("one", lambda: image, Light((0, 0, 1))),), (camera,), (mask,))
    with pytest.raises(InputError, match="no image of capture 'away' shows mesh 'test'"):
        domain_from_mesh(taken, mesh, 8, 8)
    facing = replace(taken, cameras=(Camera.from_fov(8, 8, 40, looking((0, 0, 3))),))
    assert domain_from_mesh(facing, mesh, 8, 8).solvable.sum() > 30
    with pytest.raises(InputError, match="shows mesh 'test' lit; check its cameras, masks"):
        domain_from_mesh(replace(facing, masks=(~mask,)), mesh, 8, 8)
    with pytest.raises(InputError, match="no texel of 2 × 2 lies on 'test'"):
        domain_from_mesh(facing, replace(mesh, uvs=mesh.uvs * np.float32(0.1)), 2, 2)


def test_no_texel_is_seen_through_another_part_of_the_mesh():
    mesh = extract_mesh(monkey(1))
    camera = Camera.from_fov(200, 160, 40, looking((3.0, -3, 0.6)))
    texels = bake.bake_uv(mesh, 96, 96)
    visible = Projector(texels, bake.bake_camera(mesh, camera), camera).visible
    points = texels.position[visible].astype(np.float64)
    away = toward(camera, points)
    a, b, c = (mesh.positions[None, :, k].astype(np.float64) for k in range(3))
    pixel = 5.0 / camera.scale[0]
    hit = np.zeros(len(points), bool)
    for start in range(0, len(points), 200):
        ray, origin = away[start : start + 200, None], points[start : start + 200, None]
        p = np.cross(ray, c - a)
        det = ((b - a) * p).sum(-1)
        det = np.where(np.abs(det) < 1e-14, np.inf, det)
        s = origin - a
        q = np.cross(s, b - a)
        u, v, along = (s * p).sum(-1) / det, (ray * q).sum(-1) / det, ((c - a) * q).sum(-1) / det
        # Nearer than a grazing pixel's length it may be the same surface.
        hit[start : start + 200] = ((u >= 0) & (v >= 0) & (u + v <= 1) & (along > 10 * pixel)).any(1)
    assert len(points) > 1000 and hit.mean() < 0.002


def test_the_encoded_normal_map_renders_the_recovered_normals(tmp_path):
    obj = monkey(0, scale=(-1, 1.4, 0.8), rotation_euler=(0.1, 0.2, 0.3))
    for polygon in obj.data.polygons:
        polygon.use_smooth = True
    wanted = oracle.unit(np.array([0.7, -0.2, 0.7]))
    camera_object = orthographic_view(obj, wanted)
    rendered = render_exr(tmp_path / "normals.exr", 160)
    mesh = extract_mesh(obj)
    camera = scene.camera_from_object(camera_object, 160, 160)
    seen = bake.bake_camera(mesh, camera)
    solver = frames.from_blender(mesh, seen, np.tile(wanted, (160, 160, 1)))
    bitangent = seen.tangent[..., 3:] * np.cross(seen.normal, seen.tangent[..., :3])
    parts = (seen.tangent[..., :3], bitangent, seen.normal)
    world = sum(solver[..., k : k + 1] * part for k, part in enumerate(parts))
    # Away from silhouettes, where one Cycles sample and the pixel's centre may see different faces.
    sure = seen.coverage & (rendered[..., 3] > 0.99) & ((seen.face_normal @ camera.backward) > 0.3)
    cosine = (oracle.unit(rendered[sure][:, :3] * 2 - 1) * oracle.unit(world[sure])).sum(-1)
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    assert sure.sum() > 3000 and np.percentile(angle, 99) < 0.05
    back = frames.to_blender(mesh, seen, solver)
    np.testing.assert_allclose(back[seen.coverage], np.broadcast_to(wanted, (seen.coverage.sum(), 3)), atol=2e-6)


def orthographic_view(obj, wanted):
    """Give an object a material that shows, as a colour, the world normal of a constant normal map; add a camera."""
    material = bpy.data.materials.new("normals")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    normal, shift = tree.nodes.new("ShaderNodeNormalMap"), tree.nodes.new("ShaderNodeVectorMath")
    emission, output = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeOutputMaterial")
    normal.inputs["Color"].default_value = (*(wanted * 0.5 + 0.5), 1)
    normal.uv_map = obj.data.uv_layers.active.name
    shift.operation = "MULTIPLY_ADD"
    shift.inputs[1].default_value = shift.inputs[2].default_value = (0.5, 0.5, 0.5)
    for source, target in ((normal, shift), (shift, emission), (emission, output)):
        tree.links.new(source.outputs[0], target.inputs[0])
    obj.data.materials.append(material)
    data = bpy.data.cameras.new("view")
    data.type, data.ortho_scale = "ORTHO", 3.4
    view = bpy.data.objects.new("view", data)
    view.matrix_world = Matrix(looking((1, -5, 1)).tolist())
    bpy.context.collection.objects.link(view)
    bpy.context.scene.camera = view
    bpy.context.view_layer.update()
    return view


def render_exr(path, size):
    """Render the scene with Cycles, one sample at the pixels' centres; return (H, W, 4), row 0 at the bottom."""
    import OpenEXR

    settings = bpy.context.scene.render
    settings.engine, settings.film_transparent, settings.filepath = "CYCLES", True, str(path)
    settings.resolution_x = settings.resolution_y = size
    settings.image_settings.file_format, settings.image_settings.color_depth = "OPEN_EXR", "32"
    settings.image_settings.color_mode = "RGBA"
    cycles = bpy.context.scene.cycles
    cycles.samples, cycles.pixel_filter_type, cycles.filter_width = 1, "BOX", 0.01
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    bpy.ops.render.render(write_still=True)
    return OpenEXR.File(str(path)).channels()["RGBA"].pixels[::-1]


def test_meshes_come_out_in_world_space_with_modifiers_normals_and_a_clean_file():
    obj = monkey(1, scale=(2, 1, 0.5), location=(1, 2, 3))
    before = len(bpy.data.meshes)
    mesh = extract_mesh(obj)
    assert len(bpy.data.meshes) == before and mesh.uv_map == "UVMap" and mesh.name == obj.name
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    corners = np.array([evaluated.vertices[i].co[:] for t in evaluated.loop_triangles for i in t.vertices])
    np.testing.assert_allclose(mesh.positions.reshape(-1, 3), corners * (2, 1, 0.5) + (1, 2, 3), atol=1e-6)
    normals = np.array([evaluated.corner_normals[i].vector[:] for t in evaluated.loop_triangles for i in t.loops])
    expected = oracle.unit(normals / np.array([2, 1, 0.5]))
    np.testing.assert_allclose(mesh.normals.reshape(-1, 3), expected, atol=1e-6)


def test_tangents_follow_the_texture_and_the_sign_its_handedness():
    for mirror in (1, -1):
        mesh = extract_mesh(monkey(2, scale=(mirror, 1.2, 0.7)))
        e, d = mesh.positions[:, 1:] - mesh.positions[:, :1], mesh.uvs[:, 1:] - mesh.uvs[:, :1]
        det = np.linalg.det(d.astype(float))
        keep = np.abs(det) > 1e-9
        along = np.linalg.solve(d[keep].astype(float), e[keep].astype(float))
        cosine = (oracle.unit(along[:, 0]) * mesh.tangents[keep, 0, :3]).sum(-1)
        assert np.median(cosine) > 0.998 and np.percentile(cosine, 5) > 0.97
        bitangent = mesh.tangents[keep, 0, 3:] * np.cross(mesh.normals[keep, 0], mesh.tangents[keep, 0, :3])
        assert ((bitangent * along[:, 1]).sum(-1) > 0).mean() > 0.999
        bpy.data.objects.remove(bpy.context.object)


def test_ngons_are_cut_into_triangles():
    bpy.ops.mesh.primitive_circle_add(vertices=7, fill_type="NGON", calc_uvs=True)
    mesh = extract_mesh(bpy.context.object)
    assert mesh.positions.shape == (5, 3, 3) and bake.bake_uv(mesh, 16, 16).coverage.mean() > 0.5


def test_the_active_uv_map_is_used():
    obj = monkey()
    other = obj.data.uv_layers.new(name="other")
    obj.data.uv_layers["UVMap"].active_render = True
    obj.data.uv_layers.active = other
    assert extract_mesh(obj).uv_map == "other"


def without_uv(obj):
    while obj.data.uv_layers:
        obj.data.uv_layers.remove(obj.data.uv_layers[0])


def change_uvs(obj, change):
    layer = obj.data.uv_layers.active
    values = np.empty(2 * len(obj.data.loops), np.float32)
    layer.uv.foreach_get("vector", values)
    layer.uv.foreach_set("vector", np.ascontiguousarray(change(values.reshape(-1, 2)), np.float32).ravel())


def flatten(obj):
    obj.scale = (1, 0, 1)
    bpy.context.view_layer.update()


def hide(obj):
    obj.hide_viewport = True
    bpy.context.view_layer.update()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (without_uv, "'Suzanne' has no UV map"),
        (lambda obj: change_uvs(obj, lambda uv: uv * 1.5), "do not lie in one UDIM tile"),
        (lambda obj: change_uvs(obj, lambda uv: uv * 0 + 0.5), "gives no area to 100 %"),
        (lambda obj: obj.data.clear_geometry(), "'Suzanne' has no faces"),
        (flatten, "'Suzanne' has a scale of zero"),
        (hide, "'Suzanne' is not in the active view layer or is hidden"),
    ],
)
def test_a_mesh_that_cannot_be_baked_is_refused_by_name(change, message):
    obj = monkey()
    change(obj)
    obj.data.update_tag()
    with pytest.raises(InputError, match=message):
        extract_mesh(obj)
    assert not [mesh for mesh in bpy.data.meshes if mesh.name.startswith("irpso")]


def test_overlapping_texture_coordinates_are_refused_unless_allowed():
    one = oracle.plane(u_span=(0, 0.75))
    both = oracle.joined(one, oracle.plane(z=1, u_span=(0.5, 1.0)))
    assert bake.overlap(both) == pytest.approx(0.25, abs=1e-3)
    with pytest.raises(InputError, match="'UVMap' of 'test' overlaps itself over 25 %"):
        bake.bake_uv(both, 16, 16)
    assert bake.bake_uv(both, 16, 16, allow_overlap=True).coverage.all()
    assert bake.overlap(one) == 0 and bake.overlap(extract_mesh(monkey(1))) < 1e-4


@pytest.mark.parametrize(("kind", "name"), [("ARRAY", "Row"), ("MIRROR", "Other half"), ("SOLIDIFY", "Wall")])
def test_copies_by_a_modifier_are_refused_by_its_name(kind, name):
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=3, y_subdivisions=2, location=(2, 0, 0))
    obj = bpy.context.object
    obj.modifiers.new("Bend", "SIMPLE_DEFORM")
    modifier = obj.modifiers.new(name, kind)
    if kind == "SOLIDIFY":
        modifier.use_rim = False
    bpy.context.view_layer.update()
    with pytest.raises(InputError, match=f"overlaps itself over .* %.*, because modifier '{name}' makes copies"):
        bake.bake_uv(extract_mesh(obj), 16, 16)
    modifier.show_viewport = False
    bpy.context.view_layer.update()
    assert bake.overlap(extract_mesh(obj)) == 0


def test_a_modifier_is_not_blamed_for_overlaps_of_the_uv_map():
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=4, y_subdivisions=4)
    obj = bpy.context.object
    layer = obj.data.uv_layers.active
    for number, item in enumerate(layer.uv):
        item.vector = (item.vector[0] * (0.5 + 0.02 * (number % 5)), item.vector[1])  # askew, and over each other
    for item in layer.uv[: len(layer.uv) // 2]:
        item.vector = (item.vector[0], item.vector[1] + 0.4)
    obj.modifiers.new("Nodes", "NODES")
    bpy.context.view_layer.update()
    with pytest.raises(InputError, match="texels; unwrap the mesh"):
        bake.bake_uv(extract_mesh(obj), 16, 16)


@pytest.mark.parametrize("fit", ["AUTO", "HORIZONTAL", "VERTICAL"])
@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
@pytest.mark.parametrize(
    ("width", "height", "aspect"), [(320, 200, (1, 1)), (200, 320, (1, 1)), (300, 200, (1.0, 2.0))]
)
def test_a_blender_camera_projects_as_blender_says(fit, kind, width, height, aspect):
    data = bpy.data.cameras.new("camera")
    data.type, data.sensor_fit, data.lens, data.ortho_scale = kind, fit, 35, 3.2
    data.sensor_width, data.sensor_height, data.shift_x, data.shift_y = 32, 20, 0.11, -0.07
    obj = bpy.data.objects.new("camera", data)
    obj.matrix_world = Matrix(looking((2, -4, 1)).tolist()) @ Matrix.Scale(2.5, 4)
    bpy.context.collection.objects.link(obj)
    bpy.context.view_layer.update()
    render = bpy.context.scene.render
    render.resolution_x, render.resolution_y = width, height
    render.pixel_aspect_x, render.pixel_aspect_y = aspect
    camera = scene.camera_from_object(obj, width, height, aspect)
    points = np.random.default_rng(0).uniform(-1, 1, (50, 3))
    pixels, depth = camera.project(points)
    expected = np.array([world_to_camera_view(bpy.context.scene, obj, Vector(p))[:] for p in points])
    np.testing.assert_allclose(pixels / (width, height), expected[:, :2], atol=2e-6)
    np.testing.assert_allclose(depth, expected[:, 2], rtol=1e-5)


def test_objects_other_than_pinhole_cameras_are_refused():
    data = bpy.data.cameras.new("fish")
    data.type = "PANO"
    with pytest.raises(InputError, match="'fish' is panoramic"):
        scene.camera_from_object(bpy.data.objects.new("fish", data), 8, 8)
    with pytest.raises(InputError, match="not a camera"):
        scene.camera_from_object(monkey(), 8, 8)


def test_a_mesh_is_found_by_name_or_because_there_is_only_one():
    with pytest.raises(InputError, match="has no mesh objects"):
        scene.mesh_object()
    obj = monkey()
    assert scene.mesh_object() == obj == scene.mesh_object("Suzanne")
    bpy.ops.mesh.primitive_cube_add()
    bpy.ops.object.empty_add()
    with pytest.raises(InputError, match="2 mesh objects; choose one with --object: 'Suzanne', 'Cube'"):
        scene.mesh_object()
    with pytest.raises(InputError, match="no object 'Susan' .* are 'Suzanne', 'Cube'"):
        scene.mesh_object("Susan")
    with pytest.raises(InputError, match="object 'Empty' is of type EMPTY, not a mesh"):
        scene.mesh_object("Empty")


def test_a_blender_file_is_opened_and_another_file_is_refused(tmp_path):
    monkey().name = "Saved"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "kept.blend"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene.open_blend(tmp_path / "kept.blend")
    assert scene.mesh_object().name == "Saved"
    (tmp_path / "text.blend").write_text("no blend file")
    with pytest.raises(InputError, match="cannot open"):
        scene.open_blend(tmp_path / "text.blend")
    with pytest.raises(InputError, match="there is no Blender file"):
        scene.open_blend(tmp_path / "missing.blend")


def test_a_million_triangles_are_drawn():
    mesh = oracle.plane(columns=1000, rows=500)
    drawn = bake.bake_uv(mesh, 200, 100, allow_overlap=True)
    assert drawn.coverage.all() and drawn.triangle.max() > 990_000
    x, y = np.meshgrid((np.arange(200) + 0.5) / 100 - 1, (np.arange(100) + 0.5) / 50 - 1)
    np.testing.assert_allclose(drawn.position[..., :2], np.stack([x, y], -1), atol=1e-5)


def test_baking_restores_the_drawing_state():
    import gpu

    bake.bake_uv(oracle.plane(), 4, 4)
    gpu.state.blend_set("ALPHA")
    gpu.state.depth_test_set("LESS_EQUAL")
    bake.bake_uv(oracle.plane(), 4, 4)
    assert (gpu.state.blend_get(), gpu.state.depth_test_get()) == ("ALPHA", "LESS_EQUAL")
    gpu.state.blend_set("NONE")
    gpu.state.depth_test_set("NONE")
    assert math.isclose(raster.triangle_numbers(np.zeros((1, 3, 4)), 2, 2, first=True).sum(), 0)


def test_tangents_of_a_large_mesh_are_deterministic_in_blocks(monkeypatch):
    from irpso_addon.blender import mesh as module

    bpy.ops.mesh.primitive_uv_sphere_add(segments=160, ring_count=120)
    sphere = bpy.context.object
    rng = np.random.default_rng(1)
    for vertex in sphere.data.vertices:
        vertex.co += 0.002 * Vector(rng.normal(size=3))
    try:
        first, second, third = (extract_mesh(sphere).tangents for _ in range(3))
        monkeypatch.setattr(module, "_TOGETHER", 1 << 30)
        whole = extract_mesh(sphere).tangents
    finally:
        bpy.data.objects.remove(sphere)
    assert len(first) > 30_000
    np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(first, third)
    np.testing.assert_array_equal(first[..., 3], whole[..., 3])
    # But for a few corners of triangles without area at the poles, whose tangents are borrowed from neighbours.
    assert np.isclose(first, whole, atol=2e-4).mean() > 0.9999
