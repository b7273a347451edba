"""Two kept materials mixed: rendered by Cycles against one material of maps that numpy has mixed."""

from dataclasses import replace

import bpy
import numpy as np
import pytest

import irpso_addon
from irpso_addon.blender.materials.material import apply_material, build_material, card_object
from irpso_addon.blender.materials.mixture import mix_materials
from irpso_addon.blender.scenes import light_units as lights
from irpso_addon.core.errors import InputError
from irpso_addon.reflectance.model import load_model
from tests.gpu.blender.test_material_cycles import SIZE, add_light, cells_of, middles, render, scene, tilted

__all__ = ["scene"]  # the fixture
pytestmark = pytest.mark.bpy_only

LAMP = tilted(25, 40)
MODELS = ("metallic_roughness", "cook_torrance_two_lobe")


@pytest.fixture
def registered():
    """The add-on, registered."""
    irpso_addon.register()
    yield
    irpso_addon.unregister()


def kept(name, seed, subject, **options):
    """Return the maps of a model, and their material."""
    model = load_model(name)
    rough = dict.fromkeys(("roughness", "r1", "r2"), (0.2, 0.7))
    _, maps = cells_of(model, seed, tilt=25, **rough)
    maps = replace(maps, **options)
    return maps, build_material(maps, subject)


def shown(material, tmp_path):
    """Return (SIZE, SIZE, 3): a card of the material under a lamp."""
    apply_material(card_object("subject", SIZE, SIZE), material)
    if "SUN" not in bpy.data.objects:
        add_light("SUN", lights.sun_strength(1.0), LAMP)
    return render(tmp_path)


def mean_of(a, b, name, share=0.5):
    """Return maps between two: normals as vectors, perceptual roughness by its square, all else as numbers."""
    values = {}
    for key in a.values:
        x, y = (m.values[key].astype(np.float64) for m in (a, b))
        if key == "normal":
            value = (1 - share) * x + share * y
            values[key] = value / np.linalg.norm(value, axis=-1, keepdims=True)
        elif key == "roughness":
            values[key] = np.sqrt((1 - share) * x**2 + share * y**2)
        else:  # r1 and r2 of the paper are widths already
            values[key] = (1 - share) * x + share * y
    return replace(a, values={key: value.astype(np.float32) for key, value in values.items()})


def close(found, expected):
    np.testing.assert_allclose(found, expected, rtol=4e-3, atol=4e-4)  # maps have 16 bits


@pytest.mark.parametrize("name", MODELS)
def test_the_mix_renders_as_the_mean_of_the_parameters(name, tmp_path):
    (a, first), (b, second) = kept(name, 1, "a"), kept(name, 2, "b")
    mix = mix_materials(first, second, factor=0.3)
    found = middles(shown(mix, tmp_path))  # of cells: between them bilinear filtering comes before the mix
    close(found, middles(shown(build_material(mean_of(a, b, name, 0.3), "mean"), tmp_path)))
    assert abs(found - middles(shown(first, tmp_path))).max() > 0.05


def test_mixed_normals_are_unit_vectors_whatever_node_takes_them(tmp_path):
    (_, first), (_, second) = kept("lambert", 1, "a"), kept("lambert", 2, "b")
    mix = mix_materials(first, second)
    tree, kinds = mix.node_tree, ("ShaderNodeVectorMath", "ShaderNodeEmission")
    length, glow = (tree.nodes.new(kind) for kind in kinds)
    length.operation = "LENGTH"
    tree.links.new(tree.nodes["Mix"].outputs["Normal"], length.inputs[0])
    tree.links.new(length.outputs["Value"], glow.inputs["Strength"])
    tree.links.new(glow.outputs["Emission"], tree.get_output_node("ALL").inputs["Surface"])
    np.testing.assert_allclose(shown(mix, tmp_path), 1.0, atol=1e-5)


@pytest.mark.parametrize("end", [0.0, 1.0])
def test_at_its_ends_the_mix_is_either_material(end, tmp_path):
    (_, first), (_, second) = kept("metallic_roughness", 1, "a"), kept("metallic_roughness", 2, "b")
    close(shown(mix_materials(first, second, factor=end), tmp_path), shown((first, second)[round(end)], tmp_path))


def test_a_mask_shows_the_first_where_it_is_black_and_the_second_where_it_is_white(tmp_path):
    (_, first), (_, second) = kept("metallic_roughness", 1, "a"), kept("metallic_roughness", 2, "b")
    mask = bpy.data.images.new("mask", SIZE, SIZE, is_data=True)
    right = np.broadcast_to((np.arange(SIZE) >= SIZE // 2)[None, :, None], (SIZE, SIZE, 4))
    mask.pixels.foreach_set(right.astype(np.float32).ravel())
    found = shown(mix_materials(first, second, mask), tmp_path)
    middle = SIZE // 2
    close(found[:, : middle - 1], shown(first, tmp_path)[:, : middle - 1])
    close(found[:, middle + 1 :], shown(second, tmp_path)[:, middle + 1 :])


def test_at_scale_two_the_second_repeats_twice_along_each_side(tmp_path):
    (a, first), halves = kept("lambert", 1, "a"), np.zeros((SIZE, SIZE, 3), np.float32)
    halves[:, : SIZE // 2, 0], halves[: SIZE // 2, :, 2] = 0.8, 0.5
    flat = np.broadcast_to(np.float32([0, 0, 1]), a.values["normal"].shape)
    second = build_material(replace(a, values={"base_color": halves, "normal": flat}), "b")
    found = shown(mix_materials(first, second, factor=1.0, scale=2.0), tmp_path) / LAMP[2]
    places = np.array([4, 12, 20, 28])  # the middles of four stripes
    close(found[np.ix_(places, places, [0])][..., 0], np.tile([0.8, 0.0], (4, 2)))
    close(found[np.ix_(places, places, [2])][..., 0], np.tile([[0.5], [0.0]], (2, 4)))


def test_gloss_and_relief_of_either_capture_are_inputs_with_their_values():
    (_, first), (_, second) = kept("metallic_roughness", 1, "a"), kept("metallic_roughness", 2, "b")
    second.node_tree.nodes["IRPSO look"].inputs["Roughness Factor"].default_value = 0.5
    nodes = mix_materials(first, second).node_tree.nodes
    assert [nodes[of].inputs["Roughness Factor"].default_value for of in ("First", "Second")] == [1.0, 0.5]
    assert [nodes[of].inputs["Normal Strength"].default_value for of in ("First", "Second")] == [1.0, 1.0]


def test_nodes_that_the_user_has_added_take_part(tmp_path):
    (_, first), (_, second) = kept("metallic_roughness", 1, "a"), kept("metallic_roughness", 2, "b")
    hue = first.node_tree.nodes.new("ShaderNodeHueSaturation")
    hue.inputs["Saturation"].default_value = 0.0
    surface = first.node_tree.nodes["IRPSO surface"]
    first.node_tree.links.new(first.node_tree.nodes["IRPSO map base_color"].outputs["Color"], hue.inputs["Color"])
    first.node_tree.links.new(hue.outputs["Color"], surface.inputs["Base Color"])
    close(shown(mix_materials(first, second, factor=0.0), tmp_path), shown(first, tmp_path))


def test_what_cannot_be_mixed_is_refused_and_leaves_nothing():
    (_, first), (_, second) = kept("metallic_roughness", 1, "a"), kept("cook_torrance_two_lobe", 2, "b")
    (_, brushed), plain = kept("anisotropic", 3, "c"), bpy.data.materials.new("plain")
    (_, curved) = kept("metallic_roughness", 4, "d")
    curve, tree = curved.node_tree.nodes.new("ShaderNodeRGBCurve"), curved.node_tree
    tree.links.new(curve.outputs["Color"], tree.nodes["IRPSO surface"].inputs["Base Color"])
    before = len(bpy.data.materials), len(bpy.data.node_groups)
    for other, why in (
        (second, "different shaders"),
        (brushed, "grain"),
        (plain, "not a recovered"),
        (curved, "curves"),
    ):
        with pytest.raises(InputError, match=why):
            mix_materials(first, other)
    assert before == (len(bpy.data.materials), len(bpy.data.node_groups))


def test_the_operator_puts_the_mix_on_the_object_and_makes_a_mask_to_paint(registered):
    (_, first), (_, second) = kept("metallic_roughness", 1, "a"), kept("metallic_roughness", 2, "b")
    obj = card_object("subject", SIZE, SIZE)
    apply_material(obj, first)
    bpy.context.view_layer.objects.active = obj
    assert bpy.ops.irpso.mix_captures(other=second.name, scale=3.0) == {"FINISHED"}
    nodes = obj.active_material.node_tree.nodes
    assert obj.active_material not in (first, second) and nodes["Second"].inputs["Scale"].default_value == 3.0
    assert nodes["Mask"].image.colorspace_settings.is_data and not any(nodes["Mask"].image.pixels[:3])
    assert not bpy.ops.irpso.mix_captures.poll()  # the mix itself is not a recovered material


def test_nodes_of_the_users_keep_their_numbers_and_muted_links_stay_out(tmp_path):
    (_, first), (_, second) = kept("metallic_roughness", 1, "a"), kept("metallic_roughness", 2, "b")
    tree = first.node_tree
    surface = tree.get_output_node("ALL").inputs["Surface"].links[0].from_node
    number, color = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("Value", "RGB"))
    number.outputs[0].default_value, color.outputs[0].default_value = 0.7, (0.8, 0.1, 0.05, 1)
    tree.links.new(number.outputs[0], surface.inputs["Roughness"])
    tree.links.new(color.outputs[0], surface.inputs["Base Color"])
    surface.inputs["Metallic"].links[0].is_muted = True
    surface.inputs["Metallic"].default_value = 0.2
    close(shown(mix_materials(first, second, factor=0.0), tmp_path), shown(first, tmp_path))


@pytest.mark.parametrize("kind", ["NodeReroute", "ShaderNodeAddShader", "ShaderNodeEmission"])
def test_a_node_behind_the_surface_is_refused_and_a_reroute_is_none(kind, tmp_path):
    (_, first), (_, second) = kept("metallic_roughness", 1, "a"), kept("metallic_roughness", 2, "b")
    tree = first.node_tree
    end = tree.get_output_node("ALL").inputs["Surface"]
    node, bsdf = tree.nodes.new(kind), end.links[0].from_socket
    if kind != "ShaderNodeEmission":
        tree.links.new(bsdf, node.inputs[0])
    tree.links.new(node.outputs[0], end)
    before = [len(getattr(bpy.data, name)) for name in ("materials", "node_groups")]
    if kind == "NodeReroute":
        mix_materials(first, second)
        return
    with pytest.raises(InputError, match=f"'IRPSO a': node '{node.name}' stands behind the recovered surface; mix fi"):
        mix_materials(first, second)
    assert before == [len(getattr(bpy.data, name)) for name in ("materials", "node_groups")]


@pytest.mark.parametrize("how", ["driver_add", "keyframe_insert", "strip"])
def test_an_animated_surface_is_refused(how):
    (_, first), (_, second) = kept("metallic_roughness", 1, "a"), kept("metallic_roughness", 2, "b")
    socket = first.node_tree.get_output_node("ALL").inputs["Surface"].links[0].from_node.inputs["IOR"]
    getattr(socket, "driver_add" if how == "driver_add" else "keyframe_insert")("default_value")
    if how == "strip":  # an action that is pushed down
        animation = first.node_tree.animation_data
        animation.nla_tracks.new().strips.new("a", 0, animation.action)
        animation.action = None
    with pytest.raises(InputError, match="has a driver, or its tree has keyframes, which cannot be copied"):
        mix_materials(first, second)


def test_a_linked_material_of_the_active_ones_name_can_be_mixed_in(registered, tmp_path):
    (_, first), (_, second) = kept("metallic_roughness", 1, "a"), kept("metallic_roughness", 2, "b")
    name, first.name = first.name, "aside"
    second.name = name
    bpy.data.libraries.write(str(tmp_path / "lib.blend"), {second}, fake_user=True)
    bpy.data.materials.remove(second)
    first.name = name
    with bpy.data.libraries.load(str(tmp_path / "lib.blend"), link=True) as (_, wanted):
        wanted.materials = [name]
    (linked,) = wanted.materials
    obj = card_object("subject", SIZE, SIZE)
    apply_material(obj, first)
    bpy.context.view_layer.objects.active = obj
    assert linked.name == first.name == name
    assert bpy.ops.irpso.mix_captures(other=linked.name_full, by="FACTOR", factor=1.0) == {"FINISHED"}
    group = obj.active_material.node_tree.nodes["Second"].node_tree
    assert {node.image.library for node in group.nodes if node.type == "TEX_IMAGE"} == {linked.library}


def test_a_refused_mix_leaves_no_mask(registered):
    (_, first), (_, second) = kept("metallic_roughness", 1, "a"), kept("cook_torrance_two_lobe", 2, "b")
    obj = card_object("subject", SIZE, SIZE)
    apply_material(obj, first)
    bpy.context.view_layer.objects.active = obj
    before = len(bpy.data.images)
    with pytest.raises(RuntimeError, match="different shaders"):
        bpy.ops.irpso.mix_captures(other=second.name)
    assert len(bpy.data.images) == before


def test_the_operator_says_that_a_displacement_is_left_out(registered, capfd):
    (_, first), (_, second) = kept("metallic_roughness", 1, "a"), kept("metallic_roughness", 2, "b")
    tree = second.node_tree
    displacement = tree.nodes.new("ShaderNodeDisplacement")
    tree.links.new(displacement.outputs[0], tree.get_output_node("ALL").inputs["Displacement"])
    obj = card_object("subject", SIZE, SIZE)
    apply_material(obj, first)
    bpy.context.view_layer.objects.active = obj
    bpy.ops.irpso.mix_captures(other=second.name)
    assert f"The mix has no displacement, unlike '{second.name}'" in capfd.readouterr().out


def test_the_operator_refuses_a_mask_that_is_not_chosen(registered):
    (_, first), (_, second) = kept("metallic_roughness", 1, "a"), kept("metallic_roughness", 2, "b")
    obj = card_object("subject", SIZE, SIZE)
    apply_material(obj, first)
    bpy.context.view_layer.objects.active = obj
    with pytest.raises(RuntimeError, match="Mask: no image is chosen"):
        bpy.ops.irpso.mix_captures(other=second.name, by="IMAGE")
    assert obj.active_material == first and len(bpy.data.materials) == 2
