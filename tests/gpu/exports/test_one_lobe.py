"""Materials of two lobes as textures of one, shaded by float64 oracles away from the highlight."""

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.exports import gltf, textures
from tests.builders.exports import SHAPE, on_a_sheet, picture, result_of, unsrgb
from tests.oracles import reflectance as oracles

LIGHTS = [oracles.unit((0.6 * np.sin(a), 0.8 * np.sin(a), np.cos(a))) for a in np.radians((-70, -50, 50))]


@pytest.fixture
def two_lobes():
    made = result_of("cook_torrance_two_lobe", tilt=0)
    return replace(made, maps=replace(made.maps, values=made.maps.values | {"base_color": colours()}))


def colours():
    """Base colours from 0.3 to 0.9."""
    return np.float32(np.broadcast_to(np.linspace(0.3, 0.9, SHAPE[1])[None, :, None], (*SHAPE, 3)))


@pytest.mark.parametrize(("angle", "bound"), [(0, 0.015), (45, 0.02), (60, 0.045)])
def test_a_shader_of_layers_is_as_bright_as_the_material_of_two_lobes(angle, bound, two_lobes, tmp_path):
    textures.write_textures(two_lobes, tmp_path)
    base, roughness, specular = (
        picture(tmp_path / f"leaf_{name}.png").astype(float) for name in ("BaseColor", "Roughness", "Specular")
    )
    v = two_lobes.maps.values
    shown = {
        "base_color": unsrgb(base[..., :3]), "roughness": roughness[..., 0], "specular": specular[..., 0],
        "normal": v["normal"],
    }  # fmt: skip
    own = {**v, **{name: v[name][..., 0] for name in ("r1", "r2", "w")}}
    view = np.array([-np.sin(np.radians(angle)), 0, np.cos(np.radians(angle))])
    for light in LIGHTS[1:] if angle == 0 else LIGHTS[:1]:
        ratio = oracles.principled(shown, light, view) / oracles.cook_torrance_two_lobe(own, light, view)
        assert abs(ratio.mean() - 1) < bound, (light, ratio.mean())


def test_the_base_is_raised_only_for_shaders_that_take_the_lobe_off_it(two_lobes, tmp_path):
    raised = {}
    for convention, name in {"blender": "leaf_BaseColor", "unity": "leaf_BaseMap", "unreal": "T_leaf_BC"}.items():
        textures.write_textures(two_lobes, tmp_path / convention, convention)
        raised[convention] = unsrgb(picture(tmp_path / convention / f"{name}.png")[..., :3].astype(float)) / colours()
    assert 1.02 < raised["blender"].mean() < 1.05
    np.testing.assert_array_equal(raised["unity"], raised["blender"])
    np.testing.assert_allclose(raised["unreal"], 1, atol=0.02)  # 8 bits


def test_the_base_of_gltf_is_raised(tmp_path, monkeypatch):
    result, obj = on_a_sheet("cook_torrance_two_lobe")
    pictures = []
    monkeypatch.setattr(gltf, "write_glb", lambda path, obj, name, surfaces, *rest: pictures.extend(surfaces.values()))
    gltf.write_gltf(result, tmp_path / "leaf.glb", obj)
    inside = result.maps.solved
    ratio = unsrgb(pictures[0].base_color[inside].astype(float)) / result.maps.values["base_color"][inside]
    assert 1.02 < np.median(ratio) < 1.05
