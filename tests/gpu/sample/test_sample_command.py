"""``irpso sample``: a small sample, read back and compared with what was put before the camera."""

import json
import tomllib

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="renders with Cycles")
PIL = pytest.importorskip("PIL.Image")

from irpso_addon.blender.images import decode  # noqa: E402
from irpso_addon.blender.scenes import table_top, true_surface  # noqa: E402
from irpso_addon.calibration.radiometry.colour_chart import patch_colours  # noqa: E402
from irpso_addon.capture.images.exr import read_exr  # noqa: E402
from irpso_addon.capture.read import read_capture  # noqa: E402
from irpso_addon.core.encode import linear_from_srgb  # noqa: E402
from irpso_addon.sample import layout  # noqa: E402
from irpso_addon.sample.relief import height  # noqa: E402
from irpso_addon.sample.render_sample import Request, sample_steps  # noqa: E402
from tests.builders.command_line import angle, run_cli  # noqa: E402

pytestmark = pytest.mark.bpy_only
SIZE, COUNT = (160, 120), 4
WORDS = ("--photographs", COUNT, "--size", "160x120", "--seed", 5)


@pytest.fixture(scope="module")
def sample(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sample") / "tile"
    code, said, error = run_cli("sample", "-o", folder, *WORDS, "--json")
    assert code == 0, error
    assert json.loads(said)["photographs"] == COUNT
    return folder


@pytest.fixture(scope="module")
def found():
    return layout.make_layout(SIZE, COUNT, 5)


@pytest.fixture(scope="module")
def pictures(sample):
    """(K, H, W, 3) linear values, row 0 at the top."""
    paths = sorted((sample / "photographs").iterdir())
    return np.stack([linear_from_srgb(np.asarray(PIL.open(p), np.float64) / 255) for p in paths])


def maps(sample):
    return read_exr(sample / "truth" / "maps.exr")


def mask(sample):
    return np.asarray(PIL.open(sample / "truth" / "tile.png"))[::-1] > 127


def test_the_folder_has_photographs_and_truth_and_nothing_else(sample):
    names = {p.relative_to(sample).as_posix() for p in sample.rglob("*") if p.is_file()}
    truth = {f"truth/{name}" for name in ("maps.exr", "tile.png", "capture.toml", "places.toml")}
    assert names == {"README.txt", *truth, *(f"photographs/IMG_000{n}.jpg" for n in range(1, COUNT + 1))}
    assert PIL.open(sample / "photographs" / "IMG_0001.jpg").size == SIZE


def test_the_page_names_commands_that_exist(sample):
    from irpso_addon import cli

    lines = [line.split() for line in (sample / "README.txt").read_text().splitlines() if "    irpso " in line]
    assert [words[1] for words in lines] == ["calibrate", "recover", "recover"]
    for words in lines:
        cli.build_parser().parse_args(words[1:])


def test_the_page_explains_the_lengths_of_its_commands_and_the_units(sample, found):
    page = (sample / "README.txt").read_text()
    assert "\n20 is the ball's radius: half of the diameter" in page and "\nAll are millimetres" in page
    assert "\n950 is the string" in page and f" {round(found.card_distance)} is from camera to tile" in page


def normals_at(found, x, y):
    """Return unit normals of the tile where rays through pixels (…), from the lower left corner, meet it: float64."""
    camera = found.camera
    slope_x, slope_y = (x - camera.centre[0]) / camera.scale[0], (y - camera.centre[1]) / camera.scale[1]
    depth = np.full(x.shape, found.card_distance)

    def place(depth):
        return depth * slope_x - layout.TILE[0], depth * slope_y - layout.TILE[1]

    for _ in range(12):  # slopes times the rays' inclination stay below 1: this converges
        depth = camera.position[2] - height(*place(depth))
    u, v = place(depth)
    step = 1e-4
    across = (height(u + step, v) - height(u - step, v)) / (2 * step)
    up = (height(u, v + step) - height(u, v - step)) / (2 * step)
    normal = np.stack([-across, -up, np.ones_like(u)], axis=-1)
    return normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def test_the_true_normals_are_those_of_the_height_function(sample, found):
    inside = mask(sample)
    inside[1:-1, 1:-1] &= inside[:-2, 1:-1] & inside[2:, 1:-1] & inside[1:-1, :-2] & inside[1:-1, 2:]
    rows, columns = (v[::5] for v in np.nonzero(inside))
    parts = (np.arange(6) + 0.5) / 6
    mean = sum(normals_at(found, columns + a, rows + b) for a in parts for b in parts)
    mean /= np.linalg.norm(mean, axis=-1, keepdims=True)
    channels = maps(sample)["normal"]
    off = angle(np.stack([channels[c] for c in "XYZ"], axis=-1)[rows, columns], mean)
    assert len(rows) > 1600
    assert np.median(off) < 0.5 and np.percentile(off, 95) < 3


def test_the_true_maps_lie_in_their_ranges_and_show_gold_glaze_and_clay(sample):
    inside, found = mask(sample), maps(sample)
    gold, rough = found["metallic"]["Y"][inside], found["roughness"]["Y"][inside]
    assert 0.08 < (gold > 0.9).mean() < 0.3 and (gold < 0.01).mean() > 0.5
    assert (rough < 0.2).mean() > 0.4 and (rough > 0.75).mean() > 0.1
    assert all(np.isfinite(c).all() and not c[~inside].any() for part in found.values() for c in part.values())


def test_the_balls_circle_encloses_the_ball_and_no_more(sample, pictures):
    x, y, radius = tomllib.loads((sample / "truth" / "places.toml").read_text())["ball"]
    rows, columns = np.mgrid[: SIZE[1], : SIZE[0]] + 0.5
    away = np.hypot(columns - x, rows - y)
    # The lamp's highlight lies inside the circle in every photograph, and the cloth around it has none.
    near, around = away < radius, (away > radius + 1) & (away < radius + 6)
    for picture in pictures.mean(axis=-1):
        assert picture[near].max() > 0.9
        assert picture[around].max() < 0.1


def test_patches_have_their_published_colour_under_the_known_light(sample, found, pictures):
    places = layout.chart_patches()
    pixels = layout.seen_from_upper_left(found.camera, places)
    chart = np.array(tomllib.loads((sample / "truth" / "places.toml").read_text())["chart"])
    assert (pixels > chart.min(axis=0)).all() and (pixels < chart.max(axis=0)).all()
    column, row = np.moveaxis(np.floor(pixels).astype(int), -1, 0)
    for lamp, picture in zip(found.lamps, pictures, strict=True):
        toward = lamp - places
        far = np.linalg.norm(toward, axis=-1)
        light = layout.LAMP_DISTANCE**2 / far**2 * toward[..., 2] / far
        mean = sum(picture[row + a, column + b] for a in (-1, 0, 1) for b in (-1, 0, 1)) / 9
        # The room's faint light adds up to 0.004; 8 bits, JPEG's colour at half resolution and noise do the rest.
        np.testing.assert_allclose(mean, patch_colours() * light[..., None], rtol=0.06, atol=0.02)
        assert np.abs(mean - patch_colours() * light[..., None]).mean() < 0.006


def test_the_true_capture_is_read_with_its_lights(sample, found):
    capture = read_capture(sample / "truth" / "capture.toml", decoder=decode)
    assert len(capture.observations) == COUNT and capture.masks[0].sum() == mask(sample).sum()
    vectors = np.array([shot.light.vector for shot in capture.observations])
    np.testing.assert_allclose(vectors, found.lamps - found.camera.position, rtol=1e-6)
    assert capture.cameras[0].scale[0] == pytest.approx(found.camera.scale[0])


def test_the_same_seed_gives_the_same_bytes_and_the_open_file_stays_as_it_is(sample, tmp_path):
    kinds = ("objects", "meshes", "cameras", "lights", "materials", "images", "worlds", "scenes", "textures")
    before = {kind: set(getattr(bpy.data, kind).keys()) for kind in kinds}
    code, _, error = run_cli("sample", "-o", tmp_path / "again", *WORDS, "--quiet")
    assert code == 0, error
    assert {kind: set(getattr(bpy.data, kind).keys()) for kind in kinds} == before
    for path in [p for p in sample.rglob("*") if p.is_file()]:
        assert (tmp_path / "again" / path.relative_to(sample)).read_bytes() == path.read_bytes(), path.name


def test_an_existing_folder_is_refused_and_stays(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    code, _, error = run_cli("sample", "-o", tmp_path, "--size", "160x120")
    assert code == 2 and "is there already and not empty" in error
    assert [p.name for p in tmp_path.iterdir()] == ["mine.txt"]


def test_what_is_stopped_leaves_nothing(tmp_path):
    before = len(bpy.data.scenes), len(bpy.data.meshes)
    steps = sample_steps(Request(COUNT, SIZE), tmp_path / "stopped", samples=1)
    while next(steps).what != "photograph 2 of 4":
        pass
    steps.close()
    assert list(tmp_path.iterdir()) == []
    assert (len(bpy.data.scenes), len(bpy.data.meshes)) == before


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--photographs", 1), "--photographs 1: give a whole number from 3 to 200"),
        (("--size", "12"), "--size 12x12: give sides of 80 to 4096 pixels"),
        (("--size", "wide"), "--size wide: give a whole number N, or WxH"),
        (("--seed", "x"), "x is not a whole number"),
    ],
)
def test_a_bad_value_gets_one_line_and_writes_nothing(tmp_path, words, said):
    code, out, error = run_cli("sample", "-o", tmp_path / "out", *words)
    assert code == 2 and said in error and error.count("\n") == 1 and not out
    assert list(tmp_path.iterdir()) == []


def test_the_table_can_be_set_in_a_blender_that_translates_names(monkeypatch):
    make = true_surface.blank_material

    def translated(name):
        material, nodes = make(name)
        for number, node in enumerate(nodes):
            node.name = f"Knoten {number}"
        return material, nodes

    for module in (true_surface, table_top):
        monkeypatch.setattr(module, "blank_material", translated)
    flat = np.full((4, 4), 0.5)
    maps = true_surface.TrueMaps(np.full((4, 4, 3), 0.5), None, flat)
    with table_top.own_scene("table") as scene:
        table_top.add_room(scene, 100.0)
        table_top.add_ball(scene, np.zeros(3), 1.0)
        table_top.add_print(scene, np.full((4, 4, 3), 0.5), (0.0, 0.0), (1.0, 1.0), 0.1)
        table_top.add_relief(scene, flat, maps, (0.0, 0.0), 1.0)
        surfaces = [
            node.inputs["Surface"].links[0].from_node.bl_idname
            for obj in scene.objects
            for node in obj.data.materials[0].node_tree.nodes
            if node.bl_idname == "ShaderNodeOutputMaterial"
        ]
    shaders = {"BsdfPrincipled": 3, "BsdfDiffuse": 1, "Emission": 1}
    assert sorted(surfaces) == sorted(f"ShaderNode{kind}" for kind, count in shaders.items() for _ in range(count))
