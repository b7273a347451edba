"""``recover`` of parts of pictures: cropped, smaller, and a card that is seen at an angle."""

import json
import re

import numpy as np
import pytest

from irpso_addon.capture.camera import Camera
from irpso_addon.capture.types import Capture, Light, Observation
from irpso_addon.capture.write import write_capture
from irpso_addon.cli.parser import build_parser
from irpso_addon.commands.options.job_options import file_capture
from tests.builders.command_line import angle, dome_lights, read_map, run_cli
from tests.builders.near_card import DISTANCE, write_near_card
from tests.oracles import reflectance as oracles

SIZE = 60, 44  # pixels
CARD = 0.4, 0.3  # a card on the plane z = 0, in metres
LAMPS = 0.5 * dome_lights(14, widest=60.0)
POWER = 0.3


@pytest.fixture(scope="module")
def tilted(tmp_path_factory):
    """Return the folder of a matt relief seen 30° from the side under near lamps, and its corners as an option."""
    camera = Camera.from_fov(*SIZE, 40.0, looking_at_card())
    fine = Camera.from_fov(*(3 * side for side in SIZE), 40.0, camera.matrix)
    ray = fine.points(1.0) - fine.position
    place = fine.position - ray * (fine.position[2] / ray[..., 2])[..., None]
    values = {"normal": normals_at(place), "albedo": np.full((*place.shape[:2], 3), (0.7, 0.5, 0.3))}
    shots = []
    for number, lamp in enumerate(LAMPS):
        toward = lamp - place
        irradiance = POWER / (toward**2).sum(axis=-1, keepdims=True)
        cosine = np.maximum((oracles.unit(toward) * values["normal"]).sum(axis=-1, keepdims=True), 0)
        radiance = values["albedo"] * cosine * irradiance
        image = radiance.reshape(SIZE[1], 3, SIZE[0], 3, 3).mean(axis=(1, 3))
        image = np.concatenate([image, np.ones((*image.shape[:2], 1))], axis=-1).astype(np.float32)
        light = Light(tuple(map(float, lamp)), (POWER,) * 3, False)
        shots.append(Observation(f"lamp {number}", lambda image=image: image, light))
    folder = tmp_path_factory.mktemp("tilted") / "capture"
    write_capture(Capture("card", tuple(shots), (camera,), (np.ones(SIZE[::-1], bool),)), folder)
    signs = np.array([(-1, 1, 0), (1, 1, 0), (1, -1, 0), (-1, -1, 0)])
    corners = camera.project(signs * np.array((*CARD, 0)) / 2)[0]
    return folder, ",".join(f"{x:.3f},{SIZE[1] - y:.3f}" for x, y in corners)


def looking_at_card():
    angle = np.radians(30)
    back = np.array([np.sin(angle), 0, np.cos(angle)])
    right = np.cross((0, 1, 0), back)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([right / np.linalg.norm(right), (0, 1, 0), back], axis=-1)
    matrix[:3, 3] = 0.75 * back
    return matrix


def normals_at(place):
    slope_x, slope_y = 0.3 * np.cos(20 * place[..., 0]), 0.25 * np.sin(25 * place[..., 1])
    return oracles.unit(np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], axis=-1))


def recover(capture, out, *options):
    code, answer, err = run_cli("recover", capture, "--model", "lambert", "-o", out, "--json", *options)
    assert (code, err) == (0, ""), err
    return json.loads(answer.splitlines()[-1])


def test_a_card_that_is_seen_at_an_angle(tilted, tmp_path):
    folder, corners = tilted
    recover(folder, tmp_path / "out", "--corners", corners, "--card-width", CARD[0])
    found = read_map(tmp_path / "out" / "normal.exr")
    height, width = found.shape[:2]
    assert width / height == pytest.approx(CARD[0] / CARD[1], rel=0.05)
    x, y = ((np.arange(count) + 0.5) / count - 0.5 for count in (width, height))
    places = np.stack(np.meshgrid(x * CARD[0], y * CARD[1]), axis=-1)
    assert angle(found, normals_at(places)).mean() < 0.5


def test_a_crop_lies_where_the_width_of_the_whole_puts_it(tmp_path):
    folder = write_near_card(tmp_path / "card", card_distance=None)
    table = folder / "capture.toml"
    table.write_text(f"card_width = {2 * DISTANCE * np.tan(np.radians(15))}\n" + table.read_text())
    options = build_parser().parse_args(["recover", str(folder), "-o", str(tmp_path / "out"), "--crop", "4,2,12,10"])
    assert file_capture(options).card_distance == pytest.approx(DISTANCE, rel=1e-6)
    options.card_width = 50.0
    code, said, _ = run_cli("inspect", folder, "--card-width", "50")
    assert code == 0 and re.search(r"card +93\.3013 from its camera, 50 × 33\.33", said), said
    assert run_cli("inspect", folder, "--card-width", "50", "--distance", "9")[0] == 2
    assert file_capture(options).card_distance == pytest.approx(50 / np.tan(np.radians(15)))


def test_a_crop_is_recovered_as_pictures_that_were_cropped(tmp_path):
    folder = write_near_card(tmp_path / "card")
    recover(folder, tmp_path / "cropped", "--crop", "4,2,12,10")
    recover(folder, tmp_path / "whole")
    cropped, whole = (read_map(tmp_path / name / "normal.exr") for name in ("cropped", "whole"))
    assert cropped.shape[:2] == (10, 12)
    assert angle(cropped, whole[4:14, 4:16]).max() < 0.2


def test_a_preview_is_a_part_of_the_size(tmp_path):
    folder = write_near_card(tmp_path / "card")
    assert recover(folder, tmp_path / "out", "--scale", 0.5)["texels"] == 8 * 12


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--crop", "1,2,3"], "--crop 1,2,3: give X,Y,WIDTH,HEIGHT in pixels"),
        (["--corners", "1,2,3"], "--corners 1,2,3: give auto, or X1,Y1"),
        (["--crop", "1,2,3,4", "--corners", "1,2,3,4,5,6,7,8"], "--crop and --corners: give one of them"),
        (["--scale", "2"], "scale is 2"),
        (["--card-width", "1", "--distance", "2"], "--distance and --card-width: give one of them"),
        (["--crop", "20,2,12,10"], "is no part of pictures of 24×16 pixels"),
    ],
)
def test_a_wrong_part_is_refused_in_one_line(tmp_path, options, said):
    folder = write_near_card(tmp_path / "card")
    code, _, err = run_cli("recover", folder, "-o", tmp_path / "out", *options)
    assert code == 2
    assert said in err
    assert err.count("\n") == 1
    assert not (tmp_path / "out").exists()
