"""The web page's controls, faults and files: mouse, fingers and keys in Chromium, and the command that writes it."""

import json
import re

import numpy as np
import pytest

from irpso_addon.exports.ptm import even_lights
from irpso_addon.exports.result import Result
from irpso_addon.exports.web.page import write_page
from irpso_addon.results.write import write_maps
from tests.builders.command_line import run_cli, write_card
from tests.builders.exports import srgb
from tests.builders.web import (
    NEEDS_CHROMIUM,
    PLAIN,
    SHAPE,
    browser,
    codes,
    maps_of,
    near_photographs,
    opened,
    oracle,
    psnr,
)  # fmt: skip

__all__ = ["browser"]  # a fixture

pytestmark = NEEDS_CHROMIUM
WINDOW = 480, 420  # small: software draws slowly


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
    page.key("ArrowDown")
    assert float(hash_of(page)["split"]) == pytest.approx(0.46)
    page.key("ArrowUp")
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


@pytest.mark.parametrize("cut", [False, True], ids=["missing", "cut off"])
def test_a_tile_that_is_missing_or_cut_off_is_named_on_the_page(cut, browser, tmp_path):
    maps = maps_of("lambert")
    write_page(Result("leaf", maps), tmp_path)
    tile = tmp_path / "tiles" / "0-0-0-maps.js"
    whole = tile.read_text()
    tile.unlink()
    if cut:
        tile.write_text(whole[: len(whole) // 2])
    browser._call("Page.navigate", url=(tmp_path / "index.html").as_uri())
    browser.until("document.getElementById('fault')?.hidden === false")
    assert "tiles/0-0-0-maps.js" in browser.run("document.getElementById('fault').textContent")


# --- command line -----------------------------------------------------------------------------------------------------


@pytest.fixture
def recovered(tmp_path):
    """A result in a folder, as recover writes it, of a capture with 12 lights."""
    maps, lights = maps_of("lambert"), even_lights(12, 60)
    gains = 0.6 + 0.1 * np.arange(12)  # of lamps, which the recovery has estimated
    pictures = np.stack([gain * oracle(maps, light)[::-1] for light, gain in zip(lights, gains, strict=True)])
    capture = write_card(tmp_path / "capture", pictures, lights)
    settings = {
        "capture": str(capture), "blend": None, "object": None, "colour_space": "auto", "skip_damaged": False,
        "distance": None, "crop": None, "corners": None, "scale": None, "card_width": None, "model": "lambert",
    }  # fmt: skip
    found = {"lights": np.pad(lights, [(0, 0), (0, 1)]).tolist(), "intensities": np.stack([gains] * 3, -1).tolist()}
    report = {"model": "lambert", "settings": settings, "lights": found, "relighting_psnr_db": {"light 4": 40.0}}
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
        number = int(one["name"].split()[-1])
        light, gain = lights[number], 0.6 + 0.1 * number
        np.testing.assert_allclose(one["light"], [*light, 0], atol=1e-5)
        browser.open(out / "index.html", f"{PLAIN}&photograph={index + 1}&split=0.5")
        assert psnr(codes(browser), srgb(gain * oracle(maps, light) / one["white"])) > 38


def test_of_photographs_of_one_name_the_page_marks_the_held_out_one(recovered, tmp_path):
    result, *_ = recovered
    table = tmp_path / "capture" / "capture.toml"
    table.write_text(table.read_text().replace("light 5", "light 4"))
    report = json.loads((result / "report.json").read_text())
    (result / "report.json").write_text(json.dumps(report | {"held_out": [4]}))
    assert run_cli("export", result, "--format", "web", "-o", tmp_path / "page", "--photographs", "12")[0] == 0
    taken = described(tmp_path / "page")["photographs"]
    assert [one["name"] for one in taken].count("light 4") == 2
    assert [one["name"] for one in taken if one["unseen"]] == ["light 4"]


def test_a_second_page_in_the_folder_leaves_none_of_the_first_ones_tiles(recovered, tmp_path):
    result, *_ = recovered
    out = tmp_path / "page"
    assert run_cli("export", result, "--format", "web", "-o", out)[0] == 0
    (out / "tiles" / "mine.txt").write_text("kept")
    assert (out / "tiles" / "0-0-0-p7.js").is_file()
    assert run_cli("export", result, "--format", "web", "-o", out, "--photographs", "0")[0] == 0
    assert {path.name for path in (out / "tiles").iterdir()} == {"0-0-0-maps.js", "mine.txt"}


def test_a_page_of_the_users_own_is_not_replaced(recovered, tmp_path):
    result, *_ = recovered
    mine = tmp_path / "site" / "index.html"
    mine.parent.mkdir()
    mine.write_text("mine")
    code, _, said = run_cli("export", result, "--format", "web", "-o", mine.parent)
    assert code == 2 and "would be replaced" in said
    assert mine.read_text() == "mine" and list(mine.parent.iterdir()) == [mine]


def test_a_script_of_the_users_own_makes_no_folder_a_page(recovered, tmp_path):
    result, *_ = recovered
    site = tmp_path / "site"
    (site / "tiles").mkdir(parents=True)
    mine = {site / "result.js": "var score;", site / "tiles" / "0-0-0-map.js": "mine"}
    for file, text in mine.items():
        file.write_text(text)
    words = ("export", result, "--format", "web", "-o", site, "--photographs", 0)
    code, _, said = run_cli(*words)
    assert code == 2 and "result.js: is there already" in said
    assert {file: file.read_text() for file in site.rglob("*.js")} == mine
    assert run_cli(*words, "--replace")[0] == 0 and (site / "tiles" / "0-0-0-map.js").read_text() == "mine"


def test_another_file_of_the_users_own_is_replaced_only_on_request(recovered, tmp_path):
    result, *_ = recovered
    mine = tmp_path / "site" / "page.css"
    mine.parent.mkdir()
    mine.write_text("mine")
    words = ("export", result, "--format", "web", "-o", mine.parent, "--photographs", 0)
    code, _, said = run_cli(*words)
    assert code == 2 and f"{mine}: is there already" in said and list(mine.parent.iterdir()) == [mine]
    assert run_cli(*words, "--replace")[0] == 0 and mine.read_text() != "mine"


def test_a_capture_that_is_gone_or_has_changed_is_named_with_the_remedy(recovered, tmp_path):
    result, maps, lights = recovered
    half = np.stack([oracle(maps, light)[::-1][:40] for light in lights])
    (tmp_path / "capture").rename(tmp_path / "moved")
    code, _, said = run_cli("export", result, "--format", "web", "-o", tmp_path / "page")
    assert code == 2 and "no longer there" in said and "--photographs 0" in said and not (tmp_path / "page").exists()
    write_card(tmp_path / "capture", half, lights)
    code, _, said = run_cli("export", result, "--format", "web", "-o", tmp_path / "page")
    assert code == 2 and "other pictures" in said and not (tmp_path / "page").exists()


def test_a_report_that_does_not_name_its_photographs_gives_a_page_without_and_says_so(recovered, tmp_path):
    result, *_ = recovered
    report = json.loads((result / "report.json").read_text())
    del report["settings"]["crop"]  # as the window writes it
    (result / "report.json").write_text(json.dumps(report))
    code, said, _ = run_cli("export", result, "--format", "web", "-o", tmp_path / "page")
    assert code == 0 and "warning: no photographs" in said and described(tmp_path / "page")["photographs"] == []
    code, _, said = run_cli("export", result, "--format", "web", "-o", tmp_path / "page", "--photographs", 3)
    assert code == 2 and "--photographs 0" in said
    code, said, _ = run_cli("export", result, "--format", "web", "-o", tmp_path / "page", "--photographs", 0)
    assert code == 0 and "warning" not in said


def test_a_mesh_is_refused_in_favour_of_gltf(recovered, tmp_path):
    result, *_ = recovered
    report = json.loads((result / "report.json").read_text())
    report["settings"]["blend"] = "head.blend"
    (result / "report.json").write_text(json.dumps(report))
    code, _, said = run_cli("export", result, "--format", "web", "-o", tmp_path / "page")
    assert code == 2 and "gltf" in said and len(said.splitlines()) == 1 and not (tmp_path / "page").exists()
