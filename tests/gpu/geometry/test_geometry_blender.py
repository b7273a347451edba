"""Blender's meshes, normal maps, cameras and files as the program reads them."""

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Matrix, Vector

from irpso_addon.blender.materials import tangent_frames as frames
from irpso_addon.blender.mesh import extract_mesh
from irpso_addon.blender.scenes import scene
from irpso_addon.core.errors import InputError
from irpso_addon.geometry.surface import bake
from tests.gpu.geometry.test_geometry_bake import looking, monkey
from tests.oracles import geometry as oracle


@pytest.fixture(autouse=True)
def empty_file():
    bpy.ops.wm.read_factory_settings(use_empty=True)


# One face in how many is smooth, one edge in how many is sharp (0: none), and whether normals are custom.
SHADINGS = {
    "smooth": (1, 0, False), "smooth, sharp edges": (1, 7, False), "flat": (0, 0, False),
    "flat, sharp edges": (0, 7, False), "mixed": (2, 0, False), "mixed, sharp edges": (2, 7, False),
    "flat, custom normals": (0, 0, True), "mixed, custom normals": (2, 0, True),
}  # fmt: skip


def shade(mesh, smooth, sharp, custom):
    for polygon in mesh.polygons:
        polygon.use_smooth = smooth > 0 and polygon.index % smooth == 0
    for edge in mesh.edges:
        edge.use_edge_sharp = sharp > 0 and edge.index % sharp == 0
    if custom:
        mesh.normals_split_custom_set([mesh.vertices[loop.vertex_index].normal[:] for loop in mesh.loops])


@pytest.mark.parametrize("shading", SHADINGS)
def test_the_encoded_normal_map_renders_the_recovered_normals(shading, tmp_path):
    obj = monkey(0, scale=(-1, 1.4, 0.8), rotation_euler=(0.1, 0.2, 0.3))
    shade(obj.data, *SHADINGS[shading])
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
    print(f"{shading}: {sure.sum()} pixels, median {np.median(angle):.4f}°, 99 % {np.percentile(angle, 99):.4f}°")
    assert sure.sum() > 3000 and np.percentile(angle, 99) < 0.05
    back = frames.to_blender(mesh, seen, solver)
    rounding = 2e-6 if shading == "smooth" else 1e-5  # frames of other shadings are further from orthogonal
    np.testing.assert_allclose(back[seen.coverage], np.broadcast_to(wanted, (seen.coverage.sum(), 3)), atol=rounding)


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
    obj.data.polygons.foreach_set("use_smooth", np.ones(len(obj.data.polygons), bool))
    obj.data.update()
    bpy.context.view_layer.update()
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


@pytest.mark.parametrize("levels", [0, 1])
def test_a_mesh_in_edit_mode_is_read_as_it_is_edited(levels):
    obj = monkey(levels)
    without_uv(obj)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.uv.smart_project()
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.transform.translate(value=(5, 0, 0))
    edited = extract_mesh(obj)
    assert obj.mode == "EDIT"
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.context.view_layer.update()
    finished = extract_mesh(obj)
    assert finished.positions[..., 0].min() > 3
    for name in ("positions", "uvs", "normals", "tangents"):
        np.testing.assert_array_equal(getattr(edited, name), getattr(finished, name))


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
    (named,) = scene.scene_cameras(["camera"], (width, height))  # with the pixels of the render settings
    np.testing.assert_array_equal(named.project(points)[0], pixels)


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
