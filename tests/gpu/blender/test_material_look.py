"""Gloss and relief of a kept material turned up and down, rendered by Cycles against maps that are so themselves."""

from dataclasses import replace

import bpy
import numpy as np
import pytest

from irpso_addon.reflectance.model import load_model
from tests.gpu.blender.test_material_cycles import CELLS, cells_of, middles, render, render_model, scene, tilted

__all__ = ["scene"]  # the fixture
pytestmark = pytest.mark.bpy_only

LAMP = tilted(25, 40)
MODELS = ("metallic_roughness", "cook_torrance_two_lobe")


def look():
    return bpy.data.materials["IRPSO subject"].node_tree.nodes["IRPSO look"].inputs


def bypass():
    """Connect the maps as they would be without the node: to the surface itself."""
    tree = bpy.data.materials["IRPSO subject"].node_tree
    node = tree.nodes["IRPSO look"]
    for socket in [s for s in node.outputs if s.is_linked]:
        (link,) = socket.links
        if link.to_node.bl_idname != "ShaderNodeNormalMap":
            tree.links.new(node.inputs[socket.name].links[0].from_socket, link.to_socket)
    tree.nodes.remove(node)


@pytest.mark.parametrize("name", MODELS)
def test_at_one_and_one_the_render_is_that_without_the_node(name, tmp_path):
    _, maps = cells_of(load_model(name), 3)
    with_it = render_model(maps, LAMP, tmp_path)
    bypass()
    without = middles(render(tmp_path))
    assert np.abs(with_it - without).max() <= 1e-6 * without.max()


@pytest.mark.parametrize("name", MODELS)
def test_a_roughness_factor_renders_as_maps_of_that_roughness(name, tmp_path):
    model = load_model(name)
    rough = {"metallic_roughness": ("roughness",), "cook_torrance_two_lobe": ("r1", "r2")}[name]
    _, maps = cells_of(model, 4, **dict.fromkeys(rough, (0.3, 0.6)))
    factor = 1.3 if name == "metallic_roughness" else 1.3**0.5  # of widths, the factor counts twice
    render_model(maps, LAMP, tmp_path)
    look()["Roughness Factor"].default_value = factor
    turned = middles(render(tmp_path))
    bpy.data.objects.remove(bpy.data.objects["SUN"])
    wider = replace(maps, values=maps.values | {one: np.float32(1.3) * maps.values[one] for one in rough})
    look()["Roughness Factor"].default_value = 1.0
    expected = render_model(wider, LAMP, tmp_path)
    np.testing.assert_allclose(turned, expected, rtol=2e-3)  # maps have 16 bits


def test_a_normal_strength_scales_the_slopes(tmp_path):
    _, maps = cells_of(load_model("lambert"), 5, tilt=25)
    render_model(maps, LAMP, tmp_path)
    look()["Normal Strength"].default_value = 0.5
    turned = middles(render(tmp_path))
    n = maps.values["normal"].astype(np.float64)
    # Blender's own: x and y of the map are scaled, and z moves toward 1 by as much.
    flatter = np.stack([0.5 * n[..., 0], 0.5 * n[..., 1], 0.5 + 0.5 * n[..., 2]], axis=-1)
    flatter /= np.linalg.norm(flatter, axis=-1, keepdims=True)
    expected = middles(maps.values["base_color"] * np.clip(flatter @ LAMP, 0, None)[..., None])
    assert expected.shape == (CELLS, CELLS, 3)
    np.testing.assert_allclose(turned, expected, atol=2e-3)
