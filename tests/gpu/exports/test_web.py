"""The web page's pixels in Chromium: against float64 oracles, the program's own render and Cycles."""

import re
from dataclasses import replace

import bpy
import numpy as np
import pytest

from irpso_addon.blender.materials.material import apply_material, build_material, card_object
from irpso_addon.blender.scenes import cycles
from irpso_addon.exports.ptm import even_lights
from irpso_addon.exports.result import Result
from irpso_addon.exports.web.page import write_page
from irpso_addon.geometry.domain import GeometryBake
from irpso_addon.reflectance.model import Parameter, shipped_models
from irpso_addon.results.false_color import false_color
from irpso_addon.solver.views.forward import Renderer
from tests.builders.exports import srgb
from tests.builders.web import (
    NEEDS_CHROMIUM,
    PLAIN,
    SHAPE,
    browser,
    codes,
    lit,
    maps_of,
    near_photographs,
    opened,
    oracle,
    psnr,
)  # fmt: skip

__all__ = ["browser"]  # a fixture

pytestmark = NEEDS_CHROMIUM


@pytest.mark.parametrize("name", shipped_models())
def test_every_model_is_relit_as_its_formula_says(name, browser, tmp_path):
    maps = maps_of(name)
    opened(browser, tmp_path, maps)
    for light in even_lights(3, 60):
        shown, wanted = lit(browser, light), srgb(oracle(maps, light))
        assert psnr(shown, wanted) > 48 and np.abs(shown - wanted).max() < 0.04


def test_ten_lights_are_those_of_the_programs_own_render(browser, tmp_path, gpu):
    maps, lights = maps_of("metallic_roughness"), even_lights(10, 70)
    bake = GeometryBake(
        np.zeros((*SHAPE, 3), np.float32), np.tile(np.float32([0, 0, 1]), (*SHAPE, 1)),
        np.tile(np.float32([1, 0, 0, 1]), (*SHAPE, 1)), maps.solved, np.zeros((*SHAPE, 2), np.float32),
    )  # fmt: skip
    table, views = np.pad(lights, [(0, 0), (0, 1)]), np.tile([0.0, 0, 1, 0], (10, 1))
    renderer = Renderer(bake, maps.model, maps.values, table, np.ones((10, 3)), views, card=True)
    opened(browser, tmp_path, maps)
    for k, light in enumerate(lights):
        assert psnr(lit(browser, light), srgb(renderer.render(k)[::-1, :, :3])) > 50
    renderer.close()


def test_ten_lights_are_those_that_cycles_renders(browser, tmp_path):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    maps, scene = maps_of("metallic_roughness", (48, 64)), bpy.context.scene
    apply_material(card_object("leaf", 48, 64), build_material(maps, "leaf"))
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.type, camera.data.ortho_scale, camera.location = "ORTHO", 1.0, (0, 0, 5)
    scene.collection.objects.link(camera)
    scene.camera = camera
    cycles.set_up(scene, cycles.View(64, 48, samples=4, bounces=0))
    lamp = cycles.only_lamp(scene, "SUN")
    opened(browser, tmp_path / "page", maps)
    found = []
    for light in even_lights(10, 60):
        cycles.place_lamp(lamp, light)
        lamp.data.use_shadow = False
        cycles.render_radiance(scene, tmp_path / "light.exr")
        found.append(psnr(lit(browser, light), srgb(cycles.read_radiance(tmp_path / "light.exr")[::-1])))
    assert min(found) > 40, found


def test_a_photograph_stands_beside_the_render_under_its_near_lamp(browser, tmp_path):
    maps = maps_of("principled")
    photographs = near_photographs(maps)
    opened(browser, tmp_path, maps, photographs)
    for k, picture in enumerate(photographs.pictures):
        wanted = srgb(picture[::-1] / np.percentile(picture, 99.5))
        browser.state(f"{PLAIN}&photograph={k + 1}&split=0")
        assert psnr(codes(browser), wanted) > 45
        browser.state(f"{PLAIN}&photograph={k + 1}&split=1")
        assert psnr(codes(browser), wanted) > 38  # a JPEG
        browser.state(f"{PLAIN}&photograph={k + 1}&split=1&exposure=-1")
        assert psnr(codes(browser), srgb(np.minimum(picture[::-1] / np.percentile(picture, 99.5), 1) / 2)) > 38
    browser.state(f"{PLAIN}&photograph=1&split=0.25&exposure=-2")
    darker, border = codes(browser), SHAPE[1] // 4
    photograph = np.minimum(photographs.pictures[0][::-1] / photographs.whites[0], 1)
    assert np.abs(darker[:, :border] - srgb(photograph[:, :border] / 4)).mean() < 0.01


def test_a_lamp_twice_as_bright_is_one_stop_of_exposure(browser, tmp_path):
    maps = maps_of("lambert")
    opened(browser, tmp_path, maps, state="light=0.3,0.1&exposure=1")
    light = np.array([0.3, 0.1, np.sqrt(1 - 0.1)])
    assert psnr(codes(browser), srgb(2 * oracle(maps, light))) > 48


def test_maps_and_uncertainties_show_their_numbers(browser, tmp_path):
    rng = np.random.default_rng(0)
    covered = rng.uniform(size=SHAPE) < 0.9
    confidence = {"roughness": rng.uniform(0, 0.3, (*SHAPE, 1)), "normal": rng.uniform(0, 0.5, (*SHAPE, 1))}
    maps = maps_of("metallic_roughness", covered=covered, confidence=confidence, residual=rng.uniform(0, 0.03, SHAPE))
    opened(browser, tmp_path, maps, state="map=normal")
    at, where = maps.values, covered[::-1]
    assert np.abs(codes(browser) - (at["normal"][::-1] * 0.5 + 0.5))[where].max() < 0.004
    browser.state(f"{PLAIN}&map=base_color")
    assert np.abs(codes(browser) - srgb(at["base_color"][::-1]))[where].max() < 0.006
    browser.state(f"{PLAIN}&map=roughness")
    assert np.abs(codes(browser) - (at["roughness"][::-1] - 0.02) / 0.98)[where].max() < 0.007
    ground = codes(browser)[~where]
    assert (ground == ground[0]).all()
    browser.state(f"{PLAIN}&map=roughness&uncertain=1")
    most = 0.25 * 0.98
    assert np.abs(codes(browser) - false_color(confidence["roughness"][::-1, :, 0], most))[where].max() < 0.03
    browser.state(f"{PLAIN}&map=normal&uncertain=1")
    assert np.abs(codes(browser) - false_color(confidence["normal"][::-1, :, 0], np.pi / 8))[where].max() < 0.03
    assert browser.run("document.getElementById('most').textContent") == "22.5° and more"
    browser.state(f"{PLAIN}&map=residual")
    assert np.abs(codes(browser) - false_color(maps.residual[::-1], 0.05))[where].max() < 0.03
    browser.state(f"{PLAIN}&uncertain=1")
    larger = np.maximum(confidence["roughness"] / most, confidence["normal"] / (np.pi / 8))
    assert np.abs(codes(browser) - false_color(larger[::-1, :, 0], 1))[where].max() < 0.03


def test_numbers_of_a_users_model_show_the_colours_of_their_pictures(browser, tmp_path):
    """Of color_space sRGB the encoded values, else fractions of the range; a missing third channel is black."""
    lambert = maps_of("lambert")
    own = (
        Parameter("tint", 3, (0.0, 2.0), (1.0,) * 3),
        Parameter("flow", 2, (-1.0, 1.0), (0.0,) * 2),
        Parameter("gloss", color_space="sRGB"),
    )
    rng = np.random.default_rng(4)
    values = {p.name: rng.uniform(*p.range, (*SHAPE, p.components)) for p in own}
    model = replace(lambert.model, parameters=(*lambert.model.parameters, *own))
    opened(browser, tmp_path, replace(lambert, model=model, values={**lambert.values, **values}))
    black = np.zeros((*SHAPE, 1))
    wanted = {
        "tint": values["tint"] / 2,
        "flow": np.concatenate([(values["flow"] + 1) / 2, black], axis=-1),
        "gloss": srgb(values["gloss"]),
    }
    for name, expected in wanted.items():
        browser.state(f"{PLAIN}&map={name}")
        assert np.abs(codes(browser) - expected[::-1]).max() < 0.02, name


# --- deep zoom --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def large(tmp_path_factory):
    """A page of 660 × 1040 texels: three levels, tiles of 510."""
    maps = maps_of("lambert", (1040, 660))
    folder = tmp_path_factory.mktemp("large")
    write_page(Result("large", maps), folder)
    return maps, folder


def test_a_window_loads_the_tiles_in_sight_alone(large, browser):
    _, folder = large
    browser.resize(300, 200)
    browser.events.clear()
    browser.open(folder / "index.html", f"{PLAIN}&x=330&y=700")
    tiles = {name for url in browser.requests() for name in re.findall(r"tiles/(\S+)-maps\.js", url)}
    assert tiles == {"2-0-0", "0-0-1"}
    assert {path.name[0] for path in (folder / "tiles").iterdir()} == {"0", "1", "2"}
    assert all(url.startswith(("file://", "data:image/")) for url in browser.requests())


def test_tiles_join_without_a_seam(large, browser):
    maps, folder = large
    browser.resize(300, 200)
    browser.open(folder / "index.html", f"{PLAIN}&x=510&y=510&light=0.4,-0.2")
    light = np.array([0.4, -0.2, np.sqrt(1 - 0.2)])
    wanted = srgb(oracle(maps, light))[410:610, 360:660]
    assert np.abs(codes(browser) - wanted).max() < 0.01
    browser.state("controls=0&zoom=3&x=510&y=510&light=0.4,-0.2")  # between texels as well
    across, down = 510 + (np.arange(300) - 149.5) / 3 - 0.5, 510 + (np.arange(200) - 99.5) / 3 - 0.5
    nearest = srgb(oracle(maps, light))[np.rint(down).astype(int)[:, None], np.rint(across).astype(int)]
    assert np.abs(codes(browser) - nearest).max() < 0.03


def test_from_afar_a_coarse_level_shows_the_mean(large, browser):
    maps, folder = large
    browser.resize(165, 260)
    browser.open(folder / "index.html", "controls=0&zoom=0.25&map=base_color")
    means = maps.values["base_color"][::-1].reshape(260, 4, 165, 4, 3).mean(axis=(1, 3))
    assert np.abs(codes(browser) - srgb(means)).max() < 0.01
