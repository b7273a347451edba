"""The material in Blender's data: images, nodes, slots, running again."""

from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest

from irpso_addon.blender.materials.material import ORIGIN, apply_material, build_material, card_object, subject_name
from irpso_addon.capture.images.exr import read_exr
from irpso_addon.core.errors import InputError
from irpso_addon.reflectance.model import Parameter, ReflectanceModel, load_model
from irpso_addon.results.maps import Maps

pytestmark = pytest.mark.bpy_only

SHAPE = (5, 7)


@pytest.fixture(autouse=True)
def empty_file():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def random_maps(model, seed=0):
    rng = np.random.default_rng(seed)
    values = {}
    for parameter in model.parameters:
        low, high = parameter.range
        value = low + (high - low) * rng.random((*SHAPE, parameter.components))
        if parameter.is_normal:
            value[..., 2] = 1.5
            value /= np.linalg.norm(value, axis=-1, keepdims=True)
        values[parameter.name] = value.astype(np.float32)
    return Maps(model, values, np.ones(SHAPE, bool))


def pixels(image):
    values = np.empty((image.size[1], image.size[0], image.channels), np.float32)
    image.pixels.foreach_get(values.reshape(-1))
    return values[..., :3]


def links(tree):
    return {(x.from_node.name, x.from_socket.name, x.to_node.name, x.to_socket.name) for x in tree.links}


def counts():
    data = bpy.data
    return [
        len(collection) for collection in (data.materials, data.images, data.node_groups, data.objects, data.meshes)
    ]


def test_images_hold_maps_in_their_colour_space_packed_and_named():
    maps = random_maps(load_model("principled"))
    build_material(maps, "icon")
    images = bpy.data.images
    assert {i.name for i in images} == {f"IRPSO icon {m}" for m in ("base_color", "normal", "roughness", "specular")}
    assert images["IRPSO icon base_color"].colorspace_settings.name == "sRGB"
    assert {images[f"IRPSO icon {m}"].colorspace_settings.name for m in ("normal", "roughness")} == {"Non-Color"}
    assert all(image.packed_file is not None and tuple(image.size) == SHAPE[::-1] for image in images)
    # 16 bits; the sRGB curve is at its steepest 13 times steeper than its inverse's mean.
    np.testing.assert_allclose(pixels(images["IRPSO icon base_color"]), maps.values["base_color"], atol=4e-5)
    np.testing.assert_allclose(pixels(images["IRPSO icon normal"]), maps.values["normal"] * 0.5 + 0.5, atol=1e-5)
    np.testing.assert_allclose(pixels(images["IRPSO icon roughness"])[..., :1], maps.values["roughness"], atol=1e-5)


def test_a_map_of_two_numbers_has_a_black_third_channel(tmp_path):
    """Blender 5.0 shows a channel that an EXR lacks as the memory was; Cycles takes a texel with NaN for black."""
    maps = random_maps(load_model("anisotropic"))
    build_material(maps, "icon")
    image = bpy.data.images["IRPSO icon anisotropy"]
    (tmp_path / "packed.exr").write_bytes(image.packed_file.data)
    (channels,) = read_exr(tmp_path / "packed.exr").values()
    assert set(channels) == {"R", "G", "B"}
    np.testing.assert_array_equal(channels["B"], 0)
    np.testing.assert_array_equal(pixels(image)[..., :1], maps.values["stretch"])


def test_a_colour_beyond_one_is_kept_unclipped():
    model = load_model("lambert")
    bright = [replace(p, range=(0.0, 4.0)) if p.is_albedo else p for p in model.parameters]
    maps = random_maps(replace(model, parameters=tuple(bright)))
    assert maps.values["base_color"].max() > 3
    build_material(maps, "icon")
    image = bpy.data.images["IRPSO icon base_color"]
    assert image.is_float and image.colorspace_settings.name == "Non-Color"
    np.testing.assert_array_equal(pixels(image), maps.values["base_color"])


def test_the_principled_material_connects_every_map():
    material = build_material(random_maps(load_model("principled")), "icon")
    assert links(material.node_tree) == {
        ("IRPSO map base_color", "Color", "IRPSO surface", "Base Color"),
        ("IRPSO map roughness", "Color", "IRPSO look", "Roughness"),
        ("IRPSO look", "Roughness", "IRPSO surface", "Roughness"),
        ("IRPSO look", "Normal Strength", "IRPSO normal normal", "Strength"),
        ("IRPSO map specular", "Color", "IRPSO surface", "Specular IOR Level"),
        ("IRPSO map normal", "Color", "IRPSO normal normal", "Color"),
        ("IRPSO normal normal", "Normal", "IRPSO surface", "Normal"),
        ("IRPSO surface", "BSDF", "IRPSO output", "Surface"),
    }
    assert material.node_tree.nodes["IRPSO surface"].distribution == "GGX"


@pytest.mark.parametrize("name", ["principled", "cook_torrance_two_lobe"])
def test_nodes_are_laid_out_left_to_right_without_overlap(name):
    material = build_material(random_maps(load_model(name)), "icon")
    for tree in (material.node_tree, *bpy.data.node_groups):
        for link in tree.links:
            assert link.from_node.location.x < link.to_node.location.x
        places = [np.array(node.location[:]) for node in tree.nodes]
        gaps = [np.abs(a - b) for i, a in enumerate(places) for b in places[:i]]
        assert all(dx >= 150 or dy >= 150 for dx, dy in gaps)


def test_the_lambert_material_has_no_specular_layer():
    inputs = build_material(random_maps(load_model("lambert")), "icon").node_tree.nodes["IRPSO surface"].inputs
    assert (inputs["Specular IOR Level"].default_value, inputs["Roughness"].default_value) == (0, 1)


def test_running_again_updates_the_same_images_material_and_group():
    model = load_model("cook_torrance_two_lobe")
    first = build_material(random_maps(model, 0), "icon")
    before = counts()
    again = random_maps(model, 1)
    assert build_material(again, "icon") == first
    assert counts() == before
    np.testing.assert_allclose(pixels(bpy.data.images["IRPSO icon base_color"]), again.values["base_color"], atol=4e-5)
    build_material(random_maps(model, 2), "other")
    assert len(bpy.data.materials) == 2
    assert len(bpy.data.node_groups) == 2  # the lobes, and the look


def test_a_renamed_image_and_material_are_still_found():
    model = load_model("lambert")
    material = build_material(random_maps(model), "icon")
    material.name, bpy.data.images["IRPSO icon normal"].name = "gold", "bumps"
    before = counts()
    assert build_material(random_maps(model, 1), "icon").name == "gold"
    assert counts() == before


def test_nodes_and_connections_of_the_user_survive_a_second_run_and_a_change_of_model():
    material = build_material(random_maps(load_model("principled")), "icon")
    tree = material.node_tree
    curve = tree.nodes.new("ShaderNodeRGBCurve")
    tree.links.new(tree.nodes["IRPSO map base_color"].outputs["Color"], curve.inputs["Color"])
    tree.links.new(curve.outputs["Color"], tree.nodes["IRPSO surface"].inputs["Base Color"])
    own_image = tree.nodes.new("ShaderNodeTexImage")
    own_image.name, own_image.location = "mine", (11, 22)
    tree.nodes["IRPSO map normal"].location = (-1000, -1000)
    kept = links(tree)
    build_material(random_maps(load_model("principled"), 1), "icon")
    assert links(tree) == kept
    assert tuple(tree.nodes["IRPSO map normal"].location) == (-1000, -1000)
    build_material(random_maps(load_model("cook_torrance_two_lobe")), "icon")
    assert tree.nodes[curve.name].inputs["Color"].links[0].from_node.name == "IRPSO map base_color"
    assert tuple(tree.nodes["mine"].location) == (11, 22)
    assert "IRPSO map roughness" not in tree.nodes
    assert tree.nodes["IRPSO surface"].bl_idname == "ShaderNodeGroup"


def test_a_nodes_label_follows_the_model_unless_the_user_has_changed_it():
    principled = load_model("principled")
    tree = build_material(random_maps(principled), "icon").node_tree
    tree.nodes["IRPSO map roughness"].label = "mine"
    sockets = {"specular": "Sheen Weight", "roughness": "Sheen Roughness"}
    other = tuple(replace(p, socket=sockets.get(p.name, p.socket)) for p in principled.parameters)
    build_material(random_maps(replace(principled, parameters=other)), "icon")
    labels = [tree.nodes[f"IRPSO map {name}"].label for name in ("specular", "roughness", "base_color")]
    assert labels == ["Sheen Weight", "mine", "Base Color"]


def test_a_node_of_the_user_behind_the_surface_stays_connected_when_the_shader_changes():
    tree = build_material(random_maps(load_model("principled")), "icon").node_tree
    mix, end = tree.nodes.new("ShaderNodeMixShader"), tree.nodes["IRPSO output"].inputs["Surface"]
    tree.links.new(tree.nodes["IRPSO surface"].outputs["BSDF"], mix.inputs[2])
    tree.links.new(mix.outputs[0], end)
    for name in ("cook_torrance_two_lobe", "principled"):
        build_material(random_maps(load_model(name)), "icon")
        assert [link.from_node.name for link in mix.inputs[2].links] == ["IRPSO surface"]
        assert [link.from_node for link in end.links] == [mix]


def test_copies_of_nodes_are_the_users_own():
    tree = build_material(random_maps(load_model("principled")), "icon").node_tree
    copies = {}
    for role in ("map roughness", "look"):
        old = tree.nodes[f"IRPSO {role}"]
        copies[role] = tree.nodes.new(old.bl_idname)
        copies[role]["irpso_role"] = old["irpso_role"]
    copies["look"].location = (11, 22)
    before = links(tree)
    build_material(random_maps(load_model("principled"), 1), "icon")
    assert links(tree) == before
    assert not any(output.is_linked for node in copies.values() for output in node.outputs)
    build_material(random_maps(load_model("lambert"), 1), "icon")
    assert set(copies.values()) <= set(tree.nodes) and tuple(copies["look"].location) == (11, 22)


def test_gloss_and_relief_set_by_the_user_survive_a_second_run_and_a_change_of_model():
    material = build_material(random_maps(load_model("principled")), "icon")
    inputs = material.node_tree.nodes["IRPSO look"].inputs
    assert {item.name: item.description[:9] for item in inputs["Roughness Factor"].node.node_tree.interface.items_tree
            if item.in_out == "INPUT" and item.description} == {
        "Roughness Factor": "Factor of", "Normal Strength": "Factor of"}  # fmt: skip
    inputs["Roughness Factor"].default_value, inputs["Normal Strength"].default_value = 0.5, 2.0
    build_material(random_maps(load_model("principled"), 1), "icon")
    for model in ("cook_torrance_two_lobe", "lambert", "principled"):
        inputs = build_material(random_maps(load_model(model)), "icon").node_tree.nodes["IRPSO look"].inputs
        assert (inputs["Roughness Factor"].default_value, inputs["Normal Strength"].default_value) == (0.5, 2.0)


def test_a_strength_set_on_the_normal_map_node_itself_is_taken_over():
    tree = build_material(random_maps(load_model("lambert")), "icon").node_tree
    tree.nodes.remove(tree.nodes["IRPSO look"])  # as in a file of an earlier version
    tree.nodes["IRPSO normal normal"].inputs["Strength"].default_value = 0.25
    build_material(random_maps(load_model("lambert")), "icon")
    assert tree.nodes["IRPSO look"].inputs["Normal Strength"].default_value == 0.25


def test_a_users_material_and_image_of_the_same_name_are_not_touched():
    mine = bpy.data.materials.new("IRPSO icon")
    image = bpy.data.images.new("IRPSO icon normal", 3, 3)
    material = build_material(random_maps(load_model("lambert")), "icon")
    assert material != mine
    assert tuple(image.size) == (3, 3)
    assert image.packed_file is None


def test_a_users_model_gets_image_nodes_and_the_sockets_it_names():
    model = ReflectanceModel(
        "velvet", "Velvet", Path("velvet.glsl"),
        (
            Parameter("n", 3, (-1.0, 1.0), (0, 0, 1), map="bumps", is_normal=True, socket="Normal"),
            Parameter("fuzz", 1, (0.0, 8.0), map="fuzz", socket="Sheen Weight"),
            Parameter("a", map="pair", socket="Roughness"),
            Parameter("tint", 3, map="pair", socket="Sheen Tint"),
            Parameter("odd", map="odd", socket="No Such Socket"),
        ),
        material={"shader": "velvet"},
    )  # fmt: skip
    maps = random_maps(model)
    tree = build_material(maps, "cloth").node_tree
    np.testing.assert_allclose(pixels(bpy.data.images["IRPSO cloth fuzz"])[..., :1], maps.values["fuzz"], rtol=1e-6)
    found = links(tree)
    assert ("IRPSO map fuzz", "Color", "IRPSO surface", "Sheen Weight") in found
    assert ("IRPSO split pair", "Red", "IRPSO look", "Roughness") in found
    assert ("IRPSO map pair", "Alpha", "IRPSO join tint", "Blue") in found
    assert ("IRPSO join tint", "Color", "IRPSO surface", "Sheen Tint") in found
    assert tree.nodes["IRPSO map odd"].image is not None
    np.testing.assert_allclose(pixels(bpy.data.images["IRPSO cloth pair"])[..., 0], maps.values["a"][..., 0], atol=1e-5)


def test_model_settings_reach_the_principled_node_and_unknown_ones_are_named():
    model = replace(
        load_model("principled"), material={"shader": "principled", "settings": {"IOR": 1.4, "Metallic": 0.25}}
    )
    inputs = build_material(random_maps(model), "icon").node_tree.nodes["IRPSO surface"].inputs
    assert inputs["IOR"].default_value == pytest.approx(1.4)
    assert inputs["Metallic"].default_value == 0.25
    model = replace(model, material={"shader": "principled", "settings": {"Gloss": 1.0}})
    before = counts()
    with pytest.raises(InputError, match="Gloss"):
        build_material(random_maps(model), "another")
    assert counts() == before


def test_a_socket_missing_from_principled_bsdf_is_named_and_nothing_is_made():
    model = load_model("principled")
    odd = tuple(replace(p, socket="Roughnes") if p.name == "roughness" else p for p in model.parameters)
    before = counts()
    with pytest.raises(InputError, match="parameter roughness names the socket 'Roughnes'"):
        build_material(random_maps(replace(model, parameters=odd)), "icon")
    assert counts() == before


def test_a_two_lobe_model_without_a_weight_or_with_unknown_words_is_refused():
    model = load_model("cook_torrance_two_lobe")
    with pytest.raises(InputError, match="Weight"):
        build_material(random_maps(replace(model, parameters=model.parameters[:-1])), "icon")
    odd = replace(model, material=model.material | {"fresnel": "none"})
    with pytest.raises(InputError, match="fresnel must be one of schlick, dielectric"):
        build_material(random_maps(odd), "icon")
    assert not bpy.data.materials


def test_a_uv_map_can_be_named():
    tree = build_material(random_maps(load_model("lambert")), "icon", uv_map="Second").node_tree
    assert tree.nodes["IRPSO normal normal"].uv_map == tree.nodes["IRPSO uv"].uv_map == "Second"
    assert ("IRPSO uv", "UV", "IRPSO map normal", "Vector") in links(tree)


def test_a_material_goes_into_the_active_slot_and_only_once():
    material = build_material(random_maps(load_model("lambert")), "icon")
    card = card_object("icon", *SHAPE)
    assert card_object("icon", *SHAPE) == card
    apply_material(card, material)
    apply_material(card, material)
    assert [slot.material for slot in card.material_slots] == [material]
    other = bpy.data.materials.new("other")
    card.data.materials.append(other)
    apply_material(card, material)
    assert [slot.material for slot in card.material_slots] == [material, other]
    another = card_object("another", *SHAPE)
    another.data.materials.append(other)
    apply_material(another, material)
    assert [slot.material for slot in another.material_slots] == [material]
    lamp = bpy.data.objects.new("lamp", bpy.data.lights.new("lamp", "SUN"))
    for thing in (lamp, bpy.data.objects.new("empty", None)):
        with pytest.raises(InputError, match="has no material"):
            apply_material(thing, material)


def test_a_card_is_one_unit_wide_and_its_uv_square_is_the_image():
    card = card_object("icon", *SHAPE)
    corners = np.array([v.co[:] for v in card.data.vertices])
    np.testing.assert_allclose(np.ptp(corners, axis=0), (1, SHAPE[0] / SHAPE[1], 0), rtol=1e-6)
    for loop, uv in zip(card.data.loops, card.data.uv_layers[0].data, strict=True):
        np.testing.assert_allclose(
            uv.uv[:], corners[loop.vertex_index, :2] / np.ptp(corners, axis=0)[:2] + 0.5, atol=1e-6
        )
    assert card.data.polygons[0].normal[2] == 1


def test_a_card_takes_the_proportions_of_other_maps_unless_it_was_edited():
    card = card_object("other shape", 3, 4)
    for height, width in ((4, 3), (4, 3), (2, 5)):
        assert card_object("other shape", height, width) == card
        found = np.array([vertex.co for vertex in card.data.vertices])
        x, y = 0.5, np.float32(0.5 * height / width)
        np.testing.assert_array_equal(found, [(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0)])
    card.data.vertices[0].co.z = 0.1
    card_object("other shape", 1, 1)
    assert card.data.vertices[1].co.y == -np.float32(0.2)


def test_a_card_in_edit_mode_takes_the_proportions_of_other_maps_unless_it_is_edited():
    card = card_object("edited shape", 3, 4)
    bpy.context.view_layer.objects.active = card
    for size in ((2, 5), (1, 1)):  # at the second, a corner has been moved
        bpy.ops.object.mode_set(mode="EDIT")
        card_object("edited shape", *size)
        bpy.ops.object.mode_set(mode="OBJECT")
        assert {abs(vertex.co.y) for vertex in card.data.vertices} == {np.float32(0.2)}
        card.data.vertices[0].co.z = 0.1


def test_maps_from_another_capture_get_a_new_name():
    found = random_maps(load_model("lambert"))
    assert subject_name("icon", "/a/icon") == "icon"
    build_material(found, "icon")[ORIGIN] = "/a/icon"
    assert subject_name("icon", "/a/icon") == "icon"
    assert subject_name("icon", "/b/icon") == "icon.001"
    build_material(found, "icon.001")[ORIGIN] = "/b/icon"
    assert subject_name("icon", "/b/icon") == "icon.001"
    assert subject_name("icon", "mesh") == "icon.002"


def test_a_mesh_does_not_take_the_material_of_a_renamed_mesh():
    first = bpy.data.objects.new("Vase", bpy.data.meshes.new("clay"))
    made = build_material(random_maps(load_model("lambert")), "Vase")
    made[ORIGIN] = "mesh"
    apply_material(first, made)
    apply_material(bpy.data.objects.new("Copy", bpy.data.meshes.new("clay copy")), made.copy())
    assert subject_name("Vase", "mesh", first) == "Vase"
    first.name = "Pot"
    second = bpy.data.objects.new("Vase", bpy.data.meshes.new("glass"))
    assert subject_name("Vase", "mesh", second) == "Vase.001"
    made = build_material(random_maps(load_model("lambert"), 1), "Vase.001")
    made[ORIGIN] = "mesh"
    apply_material(second, made)
    assert subject_name("Vase", "mesh", second) == "Vase.001"
    assert subject_name("Vase", "mesh", first) == "Vase"
