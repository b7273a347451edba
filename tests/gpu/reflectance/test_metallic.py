"""Metals told from dielectrics by the colour and strength of their highlights, and the material written of them."""

import numpy as np
import pytest

from irpso_addon.blender.materials.material import build_material
from irpso_addon.core.paths import DEFAULT_MODEL
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.maps import Maps
from tests.builders.lights import apart, photographed_card, recovered, relief

pytestmark = pytest.mark.usefixtures("gpu")

METALLIC, PRINCIPLED = load_model("principled_metallic"), load_model("principled")
DEFAULT = load_model(DEFAULT_MODEL)
SHAPE, LIGHTS = (12, 12), 40
GOLD = (1.0, 0.77, 0.34)


def card(metallic, color):
    """A relief of one material, photographed with some shadow and noise, as the oracle's model renders it."""
    rng = np.random.default_rng(3)
    truth = {
        "normal": relief(*SHAPE, rng),
        "base_color": np.broadcast_to(color, (*SHAPE, 3)) * rng.uniform(0.7, 1, (*SHAPE, 1)),
        "roughness": rng.uniform(0.3, 0.6, (*SHAPE, 1)),
        "metallic": np.full((*SHAPE, 1), metallic),
    }
    return photographed_card("principled_metallic", truth, rng), truth


@pytest.mark.parametrize(("metallic", "color"), [(0.0, (0.5, 0.3, 0.2)), (0.5, GOLD), (1.0, GOLD)])
@pytest.mark.parametrize("model", [METALLIC, DEFAULT], ids=lambda model: model.name)
def test_metallic_is_recovered_within_a_tenth(model, metallic, color):
    domain, truth = card(metallic, color)
    found = recovered(domain, model)
    off = np.abs(found["metallic"] - metallic)[..., 0]
    assert np.median(off) < 0.02
    # A metal is dark but for its highlights: some texels that show few of them are taken for dielectrics.
    assert (off < 0.1).mean() > (0.8 if metallic == 1 else 0.9)
    assert np.median(apart(found["normal"].astype(np.float64), truth["normal"])) < 0.3
    assert np.median(np.abs(found["base_color"] - truth["base_color"])) < 0.02


def test_a_free_metallic_does_not_degrade_dielectrics():
    domain, truth = card(0.0, (0.5, 0.3, 0.2))
    errors = [apart(recovered(domain, m)["normal"].astype(np.float64), truth["normal"]).mean()
              for m in (METALLIC, DEFAULT, PRINCIPLED)]  # fmt: skip
    assert max(errors[:2]) < 1.15 * errors[2]


def test_matt_paint_without_a_visible_lobe_is_not_metal():
    rng = np.random.default_rng(4)
    truth = {
        "normal": relief(*SHAPE, rng),
        "base_color": np.broadcast_to((0.45, 0.35, 0.3), (*SHAPE, 3)) * rng.uniform(0.7, 1, (*SHAPE, 1)),
    }
    found = recovered(photographed_card("lambert", truth, rng), DEFAULT)
    assert np.quantile(found["metallic"], 0.99) < 0.05


def test_gold_is_no_dielectric():
    domain, truth = card(1.0, GOLD)
    assert np.median(np.abs(recovered(domain, PRINCIPLED)["base_color"] - truth["base_color"])) > 0.2


def test_the_material_connects_metallic():
    values = {p.name: np.full((4, 4, p.components), 0.5, np.float32) for p in METALLIC.parameters}
    values["normal"] = np.broadcast_to(np.float32((0, 0, 1)), (4, 4, 3))
    tree = build_material(Maps(METALLIC, values, np.ones((4, 4), bool)), "gold").node_tree
    (link,) = [link for link in tree.links if link.to_socket.name == "Metallic"]
    assert link.from_node.name == "IRPSO map metallic"
    assert link.from_node.image.colorspace_settings.name == "Non-Color"
    surface = tree.nodes["IRPSO surface"]
    assert surface.distribution == "GGX"
    assert surface.inputs["Specular IOR Level"].default_value == 0.5
