"""Clear coats and grains found where photographs show them, and nowhere else; and the materials written of them."""

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.blender.materials.material import build_material
from irpso_addon.core.errors import InputError
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.maps import Maps
from tests.builders.lights import apart, photographed_card, recovered, relief

pytestmark = pytest.mark.usefixtures("gpu")

COAT, GRAIN = load_model("clear_coat"), load_model("anisotropic")
SHAPE, LIGHTS = (12, 12), 40
PAINT, STEEL = (0.5, 0.2, 0.15), (0.6, 0.57, 0.53)


def card(model, color, **material):
    """A relief of one material, photographed with some shadow and noise, as the oracle's model renders it."""
    rng = np.random.default_rng(3)
    truth = {
        "normal": relief(*SHAPE, rng),
        "base_color": np.broadcast_to(color, (*SHAPE, 3)) * rng.uniform(0.8, 1, (*SHAPE, 1)),
        **{name: np.full((*SHAPE, 1), value) for name, value in material.items()},
    }
    return photographed_card(model.name, truth, rng), truth


def within(found, truth, bounds):
    """Assert that the median error of each parameter is below its bound."""
    for name, bound in bounds.items():
        assert np.median(np.abs(found[name] - truth[name])) < bound, name


@pytest.mark.parametrize(("metallic", "roughness", "color", "share"), [(0.0, 0.7, PAINT, 0.9), (1.0, 0.6, STEEL, 0.7)])
def test_a_coat_is_found_where_it_is_shown(metallic, roughness, color, share):
    domain, truth = card(COAT, color, roughness=roughness, metallic=metallic, coat_weight=1.0, coat_roughness=0.25)
    found = recovered(domain, COAT)
    within(found, truth, {"coat_weight": 0.05, "coat_roughness": 0.04, "metallic": 0.02, "roughness": 0.04})
    # A metal's own highlight hides a coat's from the texels that few lights show it to.
    assert (found["coat_weight"] > 0.8).mean() > share
    assert np.median(apart(found["normal"].astype(np.float64), truth["normal"])) < 0.3


@pytest.mark.parametrize(("metallic", "color"), [(0.0, PAINT), (1.0, STEEL)])
def test_no_coat_is_found_where_there_is_none(metallic, color):
    domain, truth = card(COAT, color, roughness=0.4, metallic=metallic, coat_weight=0.0, coat_roughness=0.1)
    found = recovered(domain, COAT)
    assert np.quantile(found["coat_weight"], 0.95) < 0.05
    within(found, truth, {"metallic": 0.02, "roughness": 0.02})


@pytest.mark.parametrize(("stretch", "slant"), [(0.7, 0.0), (-0.5, 0.0), (-0.3, -0.6)])
def test_a_grain_is_found_where_it_is_shown(stretch, slant):
    domain, truth = card(GRAIN, STEEL, roughness=0.45, metallic=1.0, stretch=stretch, slant=slant)
    found = recovered(domain, GRAIN)
    within(found, truth, {"stretch": 0.02, "slant": 0.02, "metallic": 0.02, "roughness": 0.02})
    for name in ("stretch", "slant"):
        assert (np.abs(found[name] - truth[name]) < 0.1).mean() > 0.9
    assert np.median(apart(found["normal"].astype(np.float64), truth["normal"])) < 0.3


@pytest.mark.parametrize(("metallic", "color"), [(0.0, PAINT), (1.0, STEEL)])
def test_no_grain_is_found_where_there_is_none(metallic, color):
    domain, truth = card(GRAIN, color, roughness=0.45, metallic=metallic, stretch=0.0, slant=0.0)
    found = recovered(domain, GRAIN)
    strength = np.hypot(found["stretch"], found["slant"])
    assert np.median(strength) < 0.06 and np.quantile(strength, 0.9) < 0.15
    within(found, truth, {"metallic": 0.02, "roughness": 0.02})


def matt_paint():
    rng = np.random.default_rng(4)
    truth = {"normal": relief(*SHAPE, rng), "base_color": np.broadcast_to(PAINT, (*SHAPE, 3))}
    return photographed_card("lambert", truth, rng)


def test_matt_paint_has_no_coat_and_no_grain():
    domain = matt_paint()
    assert np.quantile(recovered(domain, COAT)["coat_weight"], 0.95) < 0.05
    found = recovered(domain, GRAIN)
    assert np.quantile(np.hypot(found["stretch"], found["slant"]), 0.9) < 0.3


def material_of(model, **options):
    values = {p.name: np.full((4, 4, p.components), 0.5, np.float32) for p in model.parameters}
    values["normal"] = np.broadcast_to(np.float32((0, 0, 1)), (4, 4, 3))
    return build_material(Maps(model, values, np.ones((4, 4), bool)), model.name, **options).node_tree


def source_of(tree, socket):
    (link,) = [link for link in tree.links if link.to_socket.name == socket and link.to_node.name == "IRPSO surface"]
    return link.from_node


def test_the_material_connects_a_coat_and_gives_it_the_normal_map():
    tree = material_of(COAT)
    assert source_of(tree, "Coat Weight").name == "IRPSO map coat_weight"
    assert source_of(tree, "Coat Roughness").name == "IRPSO map coat_roughness"
    assert source_of(tree, "Coat Normal") == source_of(tree, "Normal")
    assert tree.nodes["IRPSO surface"].inputs["Coat IOR"].default_value == 1.5


def test_the_material_connects_a_grain_and_the_tangent_of_the_uv_map():
    tree = material_of(GRAIN, uv_map="second")
    assert source_of(tree, "Anisotropic").operation == "LENGTH"
    tangent = source_of(tree, "Tangent")
    assert tangent.direction_type == "UV_MAP" and tangent.uv_map == "second"
    assert source_of(tree, "Anisotropic Rotation").inputs[1].default_value == pytest.approx(1 / (4 * np.pi))
    before = len(tree.nodes)
    assert len(material_of(GRAIN, uv_map="second").nodes) == before  # made once, found again


@pytest.mark.parametrize("names", ["stretch", ["stretch"], ["stretch", "normal"], ["stretch", "stretch"]])
def test_a_grain_of_anything_but_two_numbers_is_refused(names):
    wrong = replace(GRAIN, material=GRAIN.material | {"anisotropy": names})
    with pytest.raises(InputError, match="two scalar parameters"):
        material_of(wrong)
