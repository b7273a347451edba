"""The web page in Chromium: its pixels against float64 oracles, the program's own render and Cycles; its controls."""

import json
import re

import bpy
import numpy as np
import pytest

from irpso_addon.blender.materials.material import apply_material, build_material, card_object
from irpso_addon.blender.scenes import cycles
from irpso_addon.exports.ptm import even_lights
from irpso_addon.exports.result import Result
from irpso_addon.exports.web.page import write_page
from irpso_addon.exports.web.photographs import Photographs
from irpso_addon.geometry.domain import GeometryBake
from irpso_addon.reflectance.model import load_model, shipped_models
from irpso_addon.results.false_color import false_color
from irpso_addon.results.maps import Maps
from irpso_addon.results.write import write_maps
from irpso_addon.solver.views.forward import Renderer
from tests.builders import browser as browsers
from tests.builders.command_line import run_cli, smooth_maps, write_card
from tests.builders.exports import srgb
from tests.oracles import reflectance as oracles

pytestmark = [
    pytest.mark.bpy_only,
    pytest.mark.skipif(
        browsers.chromium() is None, reason="Chromium is not installed; on Debian: apt-get install chromium"
    ),
]
SHAPE = (72, 96)
UP = np.array([0.0, 0.0, 1.0])
WINDOW = 480, 420  # small: software draws slowly
PLAIN = "controls=0&zoom=1"  # a texel is a pixel


@pytest.fixture(scope="module")
def browser():
    browser = browsers.Browser()
    yield browser
    browser.close()


def maps_of(name, shape=SHAPE, covered=None, **more):
    """Return smooth maps of a shipped model, away from the ends of the ranges, none of a roughness below 0.2."""
    model = load_model(name)
    scalars = [p for p in model.parameters if p.components == 1]
    ends = {p.name: np.array([0.2, 0.8]) * p.width + p.range[0] for p in scalars}
    values = smooth_maps(shape, {key: tuple(pair) for key, pair in ends.items()}, seed=3)
    values = {key: np.float32(value).reshape(*shape, -1) for key, value in values.items()}
    return Maps(model, values, np.ones(shape, bool) if covered is None else covered, **more)


def oracle(maps, light, view=UP):
    """Return (H, W, 3) float64 radiance, row 0 at the top."""
    values = {
        key: value[..., 0] if value.shape[-1] == 1 else value
        for key, value in ((key, np.float64(value)) for key, value in maps.values.items())
    }
    return oracles.MODELS[maps.model.name](values, light, view)[::-1]


def opened(browser, folder, maps, photographs=None, state="", name="leaf"):
    """Write a page and open it with a window of the size of the maps."""
    write_page(Result(name, maps), folder, photographs)
    browser.resize(*maps.covered.shape[::-1])
    browser.open(folder / "index.html", f"{PLAIN}&{state}")
    return folder


def codes(browser):
    return browser.screenshot() / 255.0


def psnr(a, b):
    return -10 * np.log10(((a - b) ** 2).mean())


def lit(browser, light):
    browser.state(f"{PLAIN}&light={light[0]:.6f},{light[1]:.6f}")
    return codes(browser)


# --- pixels -----------------------------------------------------------------------------------------------------------


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
        np.tile(np.float32([1, 0, 0, 1]), (*SHAPE, 1)), maps.covered, np.zeros((*SHAPE, 2), np.float32),
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


def near_photographs(maps, count=3):
    """Return photographs, by the oracle, of a card that a perspective camera sees under near lamps."""
    height, width = maps.covered.shape
    place = np.array([[-1.2, 0.9, -3.0], [2.4 / width, 0, 0], [0, -1.8 / height, 0]])
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    points = place[0] + x[..., None] * place[1] + y[..., None] * place[2]
    lamps = np.array([[-1.0, 1.4, -1.6], [1.8, 0.2, -2.0], [0.1, -0.4, -1.0]])[:count]
    intensities = np.array([[2.0, 1.5, 1.0], [1.0, 1.2, 2.0], [3.0, 3.0, 3.0]])[:count]
    pictures = []
    for lamp, intensity in zip(lamps, intensities, strict=True):
        toward = lamp - points
        radiance = oracle(maps, oracles.unit(toward)[::-1], oracles.unit(-points)[::-1])
        pictures.append((radiance * intensity / (toward**2).sum(axis=-1, keepdims=True))[::-1].astype(np.float32))
    lights = np.append(lamps, np.ones((count, 1)), axis=-1)
    return Photographs(
        ("a.jpg", "b.jpg", "c.jpg")[:count], np.arange(count) == 1, lights, intensities, np.array([0.0, 0, 0, 1]),
        place, pictures,
    )  # fmt: skip


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
    photograph = np.minimum(photographs.pictures[0][::-1] / photographs.white(0), 1)
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
    browser.state(f"{PLAIN}&map=residual")
    assert np.abs(codes(browser) - false_color(maps.residual[::-1], 0.05))[where].max() < 0.03
    browser.state(f"{PLAIN}&uncertain=1")
    larger = np.maximum(confidence["roughness"] / most, confidence["normal"] / (np.pi / 8))
    assert np.abs(codes(browser) - false_color(larger[::-1, :, 0], 1))[where].max() < 0.03


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


# --- controls ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def page(browser, tmp_path):
    """A page with photographs and uncertainties, in a window with room for the controls."""
    rng = np.random.default_rng(0)
    maps = maps_of("metallic_roughness", confidence={"roughness": rng.uniform(0, 0.3, (*SHAPE, 1))})
    write_page(Result("leaf", maps), tmp_path, near_photographs(maps))
    browser.resize(*WINDOW)
    browser.events.clear()
    browser.open(tmp_path / "index.html", "light=0,0")
    return browser


def hash_of(browser):
    return dict(part.split("=") for part in browser.run("location.hash.slice(1)").split("&"))


def test_the_keyboard_does_all_that_the_mouse_does(page):
    light = lambda: tuple(map(float, hash_of(page)["light"].split(",")))  # noqa: E731
    for key, place in (
        ("ArrowRight", (0.06, 0)),
        ("ArrowUp", (0.06, 0.06)),
        ("ArrowLeft", (0, 0.06)),
        ("ArrowDown", (0, 0)),
    ):
        page.key(key)
        assert light() == pytest.approx(place)
    names = [None, "base_color", "normal", "roughness", "metallic", "specular"]
    for digit, name in enumerate(names, start=1):
        page.key(str(digit))
        assert hash_of(page).get("map") == name
    page.key("4")
    page.key("u")
    assert hash_of(page)["uncertain"] == "1" and page.run("!document.getElementById('legend').hidden")
    page.key("3")  # no uncertainty of base colours was measured
    assert "uncertain" not in hash_of(page)
    for key, number in (("p", "1"), (".", "2"), (".", "3"), (".", "1"), (",", "3")):
        page.key(key)
        assert hash_of(page)["photograph"] == number
    assert "render" not in page.run("document.getElementById('said').textContent")
    page.key("p")
    assert "photograph" not in hash_of(page)
    page.key("]")
    assert hash_of(page)["exposure"] == "0.25"
    page.key("[")
    page.key("+")
    zoom = float(hash_of(page)["zoom"])
    page.key("ArrowRight", shift=True)
    assert float(hash_of(page)["x"]) == pytest.approx(48 + 60 / zoom, abs=0.06)
    page.key("f")
    assert "zoom" not in hash_of(page)
    page.key("o")
    assert hash_of(page)["zoom"] == "1.0000"
    page.key("h")
    assert hash_of(page)["controls"] == "0"
    page.key("h")
    page.key("?", shift=True)
    assert page.run("document.getElementById('keys').open")
    page.key("4")  # keys rest below the help
    assert "map" not in hash_of(page)
    page.key("Escape")
    assert not page.run("document.getElementById('keys').open")


def test_the_divider_moves_by_keys(page):
    page.state("photograph=2")
    page.run("document.getElementById('divider').focus()")
    page.key("ArrowLeft")
    assert float(hash_of(page)["split"]) == pytest.approx(0.48)
    assert hash_of(page)["photograph"] == "2"  # the lamp has not moved
    assert "not seen" in page.run("document.getElementById('said').textContent")


def test_the_lamp_follows_the_mouse(page):
    area = page.run("relight.page.area()")
    reach = min(area["width"], area["height"]) / 2
    page.drag((area["x"], area["y"]), (area["x"] + 0.5 * reach, area["y"] + 0.25 * reach))
    u, v = map(float, hash_of(page)["light"].split(","))
    assert (u, v) == pytest.approx((0.5, -0.25), abs=0.01)
    page.drag((area["x"], area["y"]), (area["x"] + 3 * reach, area["y"]))
    assert float(hash_of(page)["light"].split(",")[0]) == pytest.approx(0.985)


def test_the_wheel_zooms_about_the_pointer_and_the_right_button_pans(page):
    area = page.run("relight.page.area()")
    place = (area["x"] + 60, area["y"] - 40)
    fitting = page.run("relight.page.fitting")
    texel = (48 + 60 / fitting, 36 - 40 / fitting)
    page.wheel(place, -240)
    found = {key: float(hash_of(page)[key]) for key in ("zoom", "x", "y")}
    assert found["zoom"] == pytest.approx(2 * fitting, rel=1e-3)
    assert (found["x"] + 60 / found["zoom"], found["y"] - 40 / found["zoom"]) == pytest.approx(texel, abs=0.1)
    page.drag(place, (place[0] + 40, place[1]), "right")
    assert float(hash_of(page)["x"]) == pytest.approx(found["x"] - 40 / found["zoom"], abs=0.1)
    assert hash_of(page)["light"] == "0.000,0.000"


def test_one_finger_drags_the_lamp_and_two_zoom(page):
    page.resize(390, 560, 1, True)
    page.settle()
    area = page.run("relight.page.area()")
    x, y = area["x"], area["y"]
    reach = min(area["width"], area["height"]) / 2
    page.touch([(x, y)], [(x - 0.4 * reach, y)])
    assert float(hash_of(page)["light"].split(",")[0]) == pytest.approx(-0.4, abs=0.02)
    before = page.run("relight.page.fitting")
    page.touch([(x - 40, y)], [(x - 40, y), (x + 40, y)], [(x - 80, y), (x + 80, y)])
    assert float(hash_of(page)["zoom"]) == pytest.approx(2 * before, rel=0.02)
    page.resize(*WINDOW)


def test_every_control_has_a_name_and_can_be_reached_by_tab(page):
    page.state("photograph=1")
    tree = page._call("Accessibility.getFullAXTree")["nodes"]
    names = [
        (node["role"]["value"], node.get("name", {}).get("value", ""))
        for node in tree
        if not node["ignored"] and node.get("role", {}).get("value") in ("button", "slider", "image", "dialog", "group")
    ]
    assert len(names) > 15 and all(re.search("[A-Za-z]{2}", name) for _, name in names), names
    wanted = page.run("document.querySelectorAll('button:not(:disabled), input:not(:disabled), [tabindex]').length - 1")
    page.run("document.activeElement.blur()")
    reached = set()
    for _ in range(wanted + 2):
        page.key("Tab")
        reached.add(page.run("[...document.querySelectorAll('*')].indexOf(document.activeElement)"))
    assert len(reached - {-1}) >= wanted


def test_nothing_is_asked_of_the_network_and_nothing_fails(page):
    page.key("u")
    page.key("p")
    assert page.requests() and all(url.startswith(("file:", "data:", "about:")) for url in page.requests())
    assert page.faults() == []


def test_small_windows_show_all_of_the_picture_and_every_row_of_controls(page):
    boxes = """[...document.querySelectorAll('#panel, .row:not(#maps) button, #exposure, #dial')].map((part) => {
        const box = part.getBoundingClientRect();
        return [part.id, box.left, box.top, box.right, box.bottom];
    })"""
    for width, height, share in ((320, 568, 0.9), (360, 640, 0.9), (844, 390, 0.3)):
        page.resize(width, height, 1, True)
        page.settle()
        found = {name: box for name, *box in page.run(boxes)}
        assert all(x >= -1 and y >= 0 and r <= width + 1 and b <= height + 1 for x, y, r, b in found.values()), found
        assert found["dial"][0] >= found["panel"][2] or found["dial"][3] <= found["panel"][1]
        assert page.run("document.documentElement.scrollWidth <= innerWidth")
        assert page.run("relight.page.fitting") * SHAPE[1] > share * width
    page.resize(320, 568, 1, True)
    page.key("6")  # its button is out of sight
    box = "document.querySelector('#maps [aria-pressed=true]').getBoundingClientRect()"
    assert page.run(f"{box}.left >= 0 && {box}.right <= innerWidth")
    page.resize(*WINDOW)


# --- faults -----------------------------------------------------------------------------------------------------------


def test_a_model_that_webgl_refuses_is_reported_on_the_page(browser, tmp_path):
    opened(browser, tmp_path, maps_of("lambert"))
    text = (tmp_path / "result.js").read_text()
    (tmp_path / "result.js").write_text(text.replace("vec3 reflectance(", "vec3 reflect ance("))
    browser._call("Page.reload", ignoreCache=True)
    browser.wait("fault")
    assert "does not compile in WebGL 2" in browser.run("document.getElementById('fault').textContent")


def test_a_tile_that_is_missing_is_named_on_the_page(browser, tmp_path):
    maps = maps_of("lambert")
    write_page(Result("leaf", maps), tmp_path)
    (tmp_path / "tiles" / "0-0-0-maps.js").unlink()
    browser._call("Page.navigate", url=(tmp_path / "index.html").as_uri())
    browser.run("new Promise(done => setTimeout(done, 300))")
    assert "tiles/0-0-0-maps.js" in browser.run("document.getElementById('fault').textContent")


# --- command line -----------------------------------------------------------------------------------------------------


@pytest.fixture
def recovered(tmp_path):
    """A result in a folder, as recover writes it, of a capture with 12 lights."""
    maps, lights = maps_of("lambert"), even_lights(12, 60)
    capture = write_card(tmp_path / "capture", np.stack([oracle(maps, light)[::-1] for light in lights]), lights)
    settings = {
        "capture": str(capture), "blend": None, "object": None, "colour_space": "auto", "skip_damaged": False,
        "distance": None, "crop": None, "corners": None, "scale": None, "card_width": None, "model": "lambert",
    }  # fmt: skip
    report = {"model": "lambert", "settings": settings, "relighting_psnr_db": {"light 4": 40.0}}
    write_maps(maps, tmp_path / "result", report)
    return tmp_path / "result", maps, lights


def described(folder):
    return json.loads((folder / "result.js").read_text().removeprefix("relight.result = ").rstrip(";\n"))


def test_the_command_packs_the_photographs_of_the_report(recovered, browser, tmp_path):
    result, maps, lights = recovered
    out = tmp_path / "page"
    code, said, _ = run_cli("export", result, "--format", "web", "-o", out, "--photographs", "4")
    assert code == 0 and "index.html" in said
    taken = described(out)["photographs"]
    assert len(taken) == 4 and [one["unseen"] for one in taken if one["name"] == "light 4"] == [True]
    assert sum(one["unseen"] for one in taken) == 1
    browser.resize(*SHAPE[::-1])
    for index, one in enumerate(taken):
        light = lights[int(one["name"].split()[-1])]
        np.testing.assert_allclose(one["light"], [*light, 0], atol=1e-5)
        browser.open(out / "index.html", f"{PLAIN}&photograph={index + 1}&split=0.5")
        assert psnr(codes(browser), srgb(oracle(maps, light) / one["white"])) > 38


def test_a_second_page_in_the_folder_leaves_none_of_the_first_ones_tiles(recovered, tmp_path):
    result, *_ = recovered
    out = tmp_path / "page"
    assert run_cli("export", result, "--format", "web", "-o", out)[0] == 0
    (out / "tiles" / "mine.txt").write_text("kept")
    assert (out / "tiles" / "0-0-0-p7.js").is_file()
    assert run_cli("export", result, "--format", "web", "-o", out, "--photographs", "0")[0] == 0
    assert {path.name for path in (out / "tiles").iterdir()} == {"0-0-0-maps.js", "mine.txt"}


def test_a_capture_that_is_gone_or_has_changed_is_named_with_the_remedy(recovered, tmp_path):
    result, maps, lights = recovered
    half = np.stack([oracle(maps, light)[::-1][:40] for light in lights])
    (tmp_path / "capture").rename(tmp_path / "moved")
    code, _, said = run_cli("export", result, "--format", "web", "-o", tmp_path / "page")
    assert code == 2 and "no longer there" in said and "--photographs 0" in said and not (tmp_path / "page").exists()
    write_card(tmp_path / "capture", half, lights)
    code, _, said = run_cli("export", result, "--format", "web", "-o", tmp_path / "page")
    assert code == 2 and "other pictures" in said and not (tmp_path / "page").exists()


def test_a_mesh_is_refused_in_favour_of_gltf(recovered, tmp_path):
    result, *_ = recovered
    report = json.loads((result / "report.json").read_text())
    report["settings"]["blend"] = "head.blend"
    (result / "report.json").write_text(json.dumps(report))
    code, _, said = run_cli("export", result, "--format", "web", "-o", tmp_path / "page")
    assert code == 2 and "gltf" in said and len(said.splitlines()) == 1 and not (tmp_path / "page").exists()
