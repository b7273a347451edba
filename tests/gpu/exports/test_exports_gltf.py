"""glTF read back by its chunks, as its specification describes them, and shaded as viewers do."""

import functools
from dataclasses import replace

import bpy
import numpy as np
import pytest
from mathutils import Matrix, Quaternion

from irpso_addon.blender.materials.material import apply_material, build_material, card_object
from irpso_addon.blender.mesh import extract_mesh
from irpso_addon.core.errors import InputError
from irpso_addon.exports import gltf
from irpso_addon.exports.result import Result, read_result
from irpso_addon.geometry.relief.height import Height
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.maps import Maps
from irpso_addon.results.write import write_maps
from tests.builders.command_line import angle
from tests.builders.exports import accessor, image_of, lean, on_a_sheet, read_glb, srgb, unsrgb
from tests.oracles import reflectance as oracles


@pytest.fixture(autouse=True)
def empty_file():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def counts():
    return [len(getattr(bpy.data, kind)) for kind in ("objects", "meshes", "materials", "images", "node_groups")]


def test_gltf_carries_every_map_pixel_for_pixel(tmp_path):
    result, obj = on_a_sheet("principled")
    before = counts()
    gltf.write_gltf(result, tmp_path / "leaf.glb", obj)
    assert counts() == before and obj.select_get() is False
    table, binary = read_glb(tmp_path / "leaf.glb")
    (material,) = table["materials"]
    pbr, inside, v = material["pbrMetallicRoughness"], result.maps.solved, result.maps.values
    show = functools.partial(image_of, table, binary, folder=tmp_path)
    half = 0.51 / 255
    color = show(pbr["baseColorTexture"])[..., :3]
    np.testing.assert_allclose(color[inside], srgb(v["base_color"])[inside], atol=half)
    orm = show(pbr["metallicRoughnessTexture"])
    assert (orm[..., 0] == 1).all() and (orm[..., 2] == 0).all()
    np.testing.assert_allclose(orm[..., 1][inside], v["roughness"][..., 0][inside], atol=half)
    # Factors that are not written are 1.
    assert not {"roughnessFactor", "metallicFactor", "baseColorFactor"} & set(pbr)
    normal = show(material["normalTexture"])[..., :3]
    np.testing.assert_allclose(normal[inside], (v["normal"] * 0.5 + 0.5)[inside], atol=half)
    assert "scale" not in material["normalTexture"]
    # KHR_materials_specular: the factor in alpha scales F0 and F90, the colour F0 alone.
    f0, f90 = dielectric_of(table, binary, tmp_path)
    np.testing.assert_allclose(f0[inside], 0.08 * v["specular"][..., 0][inside], rtol=0.01, atol=0.08 * half)
    np.testing.assert_allclose(f90[inside & (v["specular"][..., 0] > 0.3)], 1, atol=half)


def dielectric_of(table, binary, folder):
    """Return F0 and F90 (H, W) of the material's dielectric part, by KHR_materials_ior and KHR_materials_specular."""
    (material,) = table["materials"]
    extensions = material["extensions"]
    ior, specular = extensions.get("KHR_materials_ior", {}).get("ior", 1.5), extensions["KHR_materials_specular"]
    factor, color = specular.get("specularFactor", 1.0), np.array(specular.get("specularColorFactor", [1, 1, 1]))
    places = [specular[key]["index"] for key in ("specularTexture", "specularColorTexture")]
    assert len({table["textures"][place]["source"] for place in places}) == 1  # one picture
    texels = image_of(table, binary, specular["specularTexture"], folder)
    factor, color = factor * texels[..., 3], (color * unsrgb(texels[..., :3])).mean(axis=-1)
    return np.minimum(((ior - 1) / (ior + 1)) ** 2 * color, 1) * factor, factor


@pytest.mark.parametrize(("angle_of_view", "bound"), [(0, 0.02), (60, 0.25), (75, 0.25)])
def test_a_viewer_sees_the_fresnel_reflectance_of_every_level(angle_of_view, bound, tmp_path):
    made, obj = on_a_sheet("principled", texels=32)
    level = np.geomspace(0.02, 1, 32 * 32).reshape(32, 32).astype(np.float32)
    result = replace(made, maps=replace(made.maps, values=made.maps.values | {"specular": level[..., None]}))
    gltf.write_gltf(result, tmp_path / "leaf.glb", obj)
    f0, f90 = dielectric_of(*read_glb(tmp_path / "leaf.glb"), tmp_path)
    cosine = np.cos(np.radians(angle_of_view))
    shown = f0 + (f90 - f0) * (1 - cosine) ** 5
    # At a level of 0.02 the colour of 8 bits has steps of 3 %.
    truth = oracles.dielectric(cosine, oracles.ior_from_f0(0.08 * level))
    error = np.abs(shown / truth - 1)[result.maps.solved].max()
    print(f"\nglTF reflectance at {angle_of_view}°: off by {100 * error:.1f} % at most")
    assert error < bound


def test_gltf_has_the_occlusion_of_a_cards_relief(tmp_path):
    random = np.random.default_rng(0)
    heights = 3 * random.normal(size=(16, 16)).astype(np.float32)
    values = {
        "normal": np.tile(np.float32([0, 0, 1]), (16, 16, 1)),
        "base_color": np.full((16, 16, 3), 0.5, np.float32),
    }
    maps = Maps(load_model("lambert"), values, np.ones((16, 16), bool))
    obj = card_object("leaf", 16, 16)
    apply_material(obj, build_material(maps, "leaf"))
    before = counts()
    result = Result("leaf", maps, Height(heights, maps.solved, "texels"))
    gltf.write_gltf(result, tmp_path / "leaf.glb", obj)
    assert counts() == before
    table, binary = read_glb(tmp_path / "leaf.glb")
    (material,) = table["materials"]
    red = image_of(table, binary, material["occlusionTexture"], folder=tmp_path)[..., 0]
    np.testing.assert_allclose(red, result.open_sky, atol=0.51 / 255)
    assert red.min() < 0.8


def gltf_normals(table, binary, path, unit_frame):
    """Return the angle (degrees) between what a glTF viewer shades with and the field, at points of all triangles."""
    (primitive,) = table["meshes"][0]["primitives"]
    read = {key: accessor(table, binary, at).astype(np.float64) for key, at in primitive["attributes"].items()}
    corner = accessor(table, binary, primitive["indices"]).reshape(-1, 3)
    weights = np.array([[0.6, 0.3, 0.1], [1 / 3, 1 / 3, 1 / 3], [0.2, 0.2, 0.6]])
    at = {
        key: np.einsum("pk,tki->tpi", weights, value[corner]).reshape(-1, value.shape[1]) for key, value in read.items()
    }
    image = image_of(table, binary, table["materials"][0]["normalTexture"], path)[::-1]  # v runs down in glTF
    height, width = image.shape[:2]
    x, y = at["TEXCOORD_0"][:, 0] * width - 0.5, at["TEXCOORD_0"][:, 1] * height - 0.5
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = (x - x0)[:, None], (y - y0)[:, None]
    texel = (image[y0, x0] * (1 - fx) + image[y0, x0 + 1] * fx) * (1 - fy)
    texel = (texel + (image[y0 + 1, x0] * (1 - fx) + image[y0 + 1, x0 + 1] * fx) * fy)[:, :3] * 2 - 1
    normal, tangent = at["NORMAL"], at["TANGENT"][:, :3]
    if unit_frame:  # as three.js does, and the Khronos sample viewer
        normal, tangent = oracles.unit(normal), oracles.unit(tangent)
    node = table["nodes"][0]
    turn = Matrix.LocRotScale(
        node["translation"], Quaternion((node["rotation"][3], *node["rotation"][:3])), node["scale"]
    )
    to_world = np.array(turn)
    sign = np.sign(at["TANGENT"][:, 3:] * np.linalg.det(to_world))  # viewers take the cross product in the world
    shaded = texel[:, :1] * tangent + texel[:, 1:2] * sign * np.cross(normal, tangent) + texel[:, 2:] * normal
    a, b, c = read["POSITION"][corner].transpose(1, 0, 2)
    assert (np.einsum("tki,ti->tk", read["NORMAL"][corner], np.cross(b - a, c - a)) > 0).all()  # counterclockwise
    shaded = oracles.unit(shaded @ to_world[:3, :3].T)
    surface = oracles.unit(oracles.unit(at["NORMAL"]) @ to_world[:3, :3].T)
    place = at["POSITION"] @ to_world[:3, :3].T + to_world[:3, 3]
    # glTF's y is up: (x, y, z) is Blender's (x, −z, y).
    to_blender = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    place, surface, shaded = (vector @ to_blender.T for vector in (place, surface, shaded))
    return angle(shaded, oracles.unit(surface + lean(place)))


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("smooth", [True, False])
def test_a_gltf_viewer_shades_with_the_recovered_world_normals(smooth, mirrored, tmp_path):
    result, obj = on_a_sheet("principled", texels=384, mirrored=mirrored, smooth=smooth)
    gltf.write_gltf(result, tmp_path / "leaf.glb", obj)
    table, binary = read_glb(tmp_path / "leaf.glb")
    for frame in (False, True):
        error = gltf_normals(table, binary, tmp_path, frame)
        median, high = np.percentile(error, (50, 99))
        print(f"\nglTF, {'unit' if frame else 'interpolated'} frames: median {median:.3f}°, 99 % {high:.3f}°")
        # 8 bits are 0.3°.
        assert median < (0.8 if frame else 0.3) and high < (3.0 if frame else 0.8)


def test_a_sheared_object_keeps_its_shape_and_normals(tmp_path):
    result, obj = on_a_sheet("principled", texels=32)
    parent = bpy.data.objects.new("parent", None)
    bpy.context.scene.collection.objects.link(parent)
    parent.scale, obj.parent = (2, 1, -0.5), parent
    bpy.context.view_layer.update()
    linear = np.array(obj.matrix_world)[:3, :3]
    (warning,) = gltf.write_gltf(replace(result, card=False), tmp_path / "leaf.glb", obj)["warnings"]
    assert "unequal scale" in warning
    table, binary = read_glb(tmp_path / "leaf.glb")
    node, (part,) = table["nodes"][0], table["meshes"][0]["primitives"]
    x, y, z, w = node["rotation"]
    held = Matrix.LocRotScale(node["translation"], Quaternion((w, x, y, z)), node["scale"])
    turn = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # glTF's y is up, Blender's z
    read = {k: accessor(table, binary, part["attributes"][k]).astype(np.float64) for k in ("POSITION", "NORMAL")}
    written = (read["POSITION"] @ np.array(held)[:3, :3].T + np.array(held.translation)) @ turn.T
    mesh = extract_mesh(obj)
    places, at = np.unique(mesh.positions.reshape(-1, 3).round(4), axis=0, return_index=True)
    distance = np.linalg.norm(written[:, None] - places, axis=-1)
    assert distance.min(axis=1).max() < 1e-3 and np.ptp(np.linalg.svd(linear)[1]) > 1
    normals = oracles.unit(read["NORMAL"] @ np.linalg.inv(np.array(held)[:3, :3])) @ turn.T
    assert angle(normals, mesh.normals.reshape(-1, 3)[at][distance.argmin(axis=1)]).max() < 0.1


def test_an_object_scaled_to_zero_is_refused_and_nothing_is_left(tmp_path):
    result, obj = on_a_sheet("principled", texels=32)
    obj.scale.z = 0
    bpy.context.view_layer.update()
    before = counts()
    with pytest.raises(InputError, match=f"object '{obj.name}' has a scale of zero along an axis; set its scale"):
        gltf.write_gltf(replace(result, card=False), tmp_path / "leaf.glb", obj)
    assert counts() == before and not any(tmp_path.iterdir())


def test_blenders_exporter_alone_carries_all_maps_but_specular(tmp_path):
    """Why the material is built anew for it."""
    result, obj = on_a_sheet("principled")
    obj.select_set(True)
    bpy.ops.export_scene.gltf(filepath=str(tmp_path / "own.glb"), use_selection=True, export_format="GLB")
    table, binary = read_glb(tmp_path / "own.glb")
    (material,) = table["materials"]
    inside, v = result.maps.solved, result.maps.values
    show = functools.partial(image_of, table, binary, folder=tmp_path)
    color = show(material["pbrMetallicRoughness"]["baseColorTexture"])[..., :3]
    np.testing.assert_allclose(color[inside], srgb(v["base_color"])[inside], atol=0.51 / 255)
    normal = show(material["normalTexture"])[..., :3]
    np.testing.assert_allclose(normal[inside], (v["normal"] * 0.5 + 0.5)[inside], atol=0.51 / 255)
    roughness = show(material["pbrMetallicRoughness"]["metallicRoughnessTexture"])[..., 1:2]
    np.testing.assert_allclose(roughness[inside], v["roughness"][inside], atol=0.51 / 255)
    # The factor is alpha, and the picture that it names has none, or 1 everywhere: specular is 0.5 for a viewer.
    specular = show(material["extensions"]["KHR_materials_specular"]["specularTexture"])
    assert specular.shape[-1] < 4 or (specular[..., 3] == 1).all()


def test_two_lobes_become_one_and_the_error_is_reported(tmp_path):
    result, obj = on_a_sheet("cook_torrance_two_lobe")
    found = gltf.write_gltf(result, tmp_path / "leaf.glb", obj)
    assert 0.05 < found["one_lobe_error"]["median"] < 0.5
    table, binary = read_glb(tmp_path / "leaf.glb")
    texture = table["materials"][0]["pbrMetallicRoughness"]["metallicRoughnessTexture"]
    alpha = image_of(table, binary, texture, tmp_path)[..., 1] ** 2
    inside, v = result.maps.solved, result.maps.values
    # Between the two lobes' own widths, GGX being a little wider than Beckmann at the same peak.
    assert (alpha[inside] > v["r1"][..., 0][inside] * 0.9).all() and (alpha[inside] < v["r2"][..., 0][inside]).all()


def test_gltf_of_lambert_has_no_highlight(tmp_path):
    result, obj = on_a_sheet("lambert", texels=32)
    gltf.write_gltf(result, tmp_path / "leaf.glb", obj)
    (material,) = read_glb(tmp_path / "leaf.glb")[0]["materials"]
    assert material["extensions"]["KHR_materials_specular"]["specularFactor"] == 0


@pytest.mark.parametrize(("card", "mode"), [(True, 33071), (False, 10497)])  # CLAMP_TO_EDGE, REPEAT (OpenGL)
def test_textures_of_a_card_end_at_its_borders(card, mode, tmp_path):
    result, obj = on_a_sheet("principled", texels=32)
    if card:
        obj = card_object("leaf", 32, 32)
        apply_material(obj, bpy.data.materials["IRPSO leaf"])
    gltf.write_gltf(result, tmp_path / "leaf.glb", obj)
    table, _ = read_glb(tmp_path / "leaf.glb")
    for texture in table["textures"]:
        sampler = table["samplers"][texture["sampler"]] if "sampler" in texture else {}
        assert {sampler.get(key, 10497) for key in ("wrapS", "wrapT")} == {mode}


def test_a_seamless_tile_repeats(tmp_path):
    maps = on_a_sheet("principled", texels=32)[0].maps
    write_maps(maps, tmp_path / "leaf", {"model": "principled", "settings": {}, "tile": {}})
    result = read_result(tmp_path / "leaf")
    assert result.maps.wrapped
    obj = card_object("leaf", 32, 32)
    apply_material(obj, bpy.data.materials["IRPSO leaf"])
    gltf.write_gltf(result, tmp_path / "leaf.glb", obj)
    table, _ = read_glb(tmp_path / "leaf.glb")
    samplers = [table["samplers"][t["sampler"]] if "sampler" in t else {} for t in table["textures"]]
    assert samplers and {s.get(key, 10497) for s in samplers for key in ("wrapS", "wrapT")} == {10497}


def drawn(path):
    """Return material → the number of its corners."""
    table, binary = read_glb(path)
    parts = table["meshes"][0]["primitives"]
    return {table["materials"][p["material"]]["name"]: accessor(table, binary, p["indices"]).size for p in parts}


def test_the_maps_of_a_session_or_folder_go_on_its_slots_in_its_uv_map(tmp_path):
    result, obj = on_a_sheet("principled", texels=32)
    other = build_material(result.maps, "recovered before")
    obj.data.materials.append(other)
    slots = np.arange(len(obj.data.polygons)) % 2
    obj.data.polygons.foreach_set("material_index", slots.astype(np.int32))
    bpy.context.view_layer.update()
    mesh = extract_mesh(obj, [1])
    wrong = obj.data.uv_layers.new(name="Another")
    wrong.uv.foreach_set("vector", np.full(2 * len(obj.data.loops), 0.25, np.float32))
    obj.data.uv_layers.active = wrong
    bpy.context.view_layer.update()
    gltf.write_gltf(replace(result, card=False, mesh=mesh), tmp_path / "leaf.glb", obj)
    table, binary = read_glb(tmp_path / "leaf.glb")
    names = [table["materials"][part["material"]]["name"] for part in table["meshes"][0]["primitives"]]
    assert sorted(names) == ["IRPSO leaf", "leaf"]
    part = table["meshes"][0]["primitives"][names.index("leaf")]
    corners = accessor(table, binary, part["indices"]).ravel()
    uvs = accessor(table, binary, part["attributes"]["TEXCOORD_0"])[corners] * (1, -1) + (0, 1)
    wanted = mesh.uvs[mesh.solved].reshape(-1, 2)
    assert len(uvs) == len(wanted)
    np.testing.assert_allclose(np.unique(uvs.round(4), axis=0), np.unique(wanted.round(4), axis=0), atol=2e-4)
    obj.data.uv_layers.active = obj.data.uv_layers["UVMap"]
    bpy.context.view_layer.update()
    stored = replace(result, card=False, report={"solved_slots": [1]})
    gltf.write_gltf(stored, tmp_path / "stored.glb", obj)
    assert drawn(tmp_path / "stored.glb") == drawn(tmp_path / "leaf.glb")
    obj.data.uv_layers.remove(obj.data.uv_layers["UVMap"])
    obj.data.update_tag()
    bpy.context.view_layer.update()
    with pytest.raises(InputError, match="has no UV map 'UVMap'"):
        gltf.write_gltf(replace(result, card=False, mesh=mesh), tmp_path / "again.glb", obj)


def test_a_mesh_in_edit_mode_is_exported_as_it_is_edited(tmp_path):
    result, obj = on_a_sheet("principled", texels=32)
    bpy.context.view_layer.objects.active = obj
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.transform.translate(value=(5, 0, 0), orient_type="LOCAL")
    gltf.write_gltf(replace(result, card=False), tmp_path / "leaf.glb", obj)
    assert obj.mode == "EDIT"
    table, binary = read_glb(tmp_path / "leaf.glb")
    (part,) = table["meshes"][0]["primitives"]
    written = accessor(table, binary, part["attributes"]["POSITION"])
    bpy.ops.object.mode_set(mode="OBJECT")
    edited = np.array([vertex.co[:] for vertex in obj.data.vertices])
    assert edited[:, 0].min() > 2
    for pick in (np.min, np.max):
        np.testing.assert_allclose(pick(written[:, 0]), pick(edited[:, 0]), atol=1e-5)
