"""Corners of a card found in photographs, against the camera's own projection in float64."""

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.capture.errors import CaptureError
from irpso_addon.capture.frame.board import BOARDS, PAPERS, board_of, board_picture, write_board
from irpso_addon.capture.frame.find import corner_steps, find_corners
from irpso_addon.capture.frame.homography import homography, mapped
from irpso_addon.capture.framing import AUTO, Framing, framed
from irpso_addon.capture.read import read_spec
from irpso_addon.capture.types import Capture, Light, Observation
from irpso_addon.cli import build_parser
from irpso_addon.core.errors import InputError
from tests.builders.flat_scene import from_upper_left, looking_camera, seen_plane, texture

_AROUND = np.array([(-1, 1), (1, 1), (1, -1), (-1, -1)])
_CARD = np.array([60.0, 45.0])  # half of its width and height


def capture_of(camera, pictures, **keys):
    """Return a capture of grey pictures (H, W)."""
    shots = tuple(
        Observation(str(k), lambda p=p: np.dstack([p, p, p, np.ones_like(p)]).astype(np.float32), Light((0, 0, 1)))
        for k, p in enumerate(pictures)
    )
    return Capture("card", shots, (camera,), (np.ones((camera.height, camera.width), bool),), **keys)


def card_pictures(camera, boxes, count=3, table=0.03):
    """Return pictures of cards on a table under a lamp that moves; boxes: (middle, half of the sides) of each card."""
    random, inner, around = np.random.default_rng(3), texture(1), texture(2, 30.0)

    def value(lamp, places):
        there = np.any([(np.abs(places - middle) < half).all(axis=-1) for middle, half in boxes], axis=0)
        far = np.linalg.norm(np.concatenate([places - lamp, np.full((*places.shape[:-1], 1), 300.0)], -1), axis=-1)
        return (300 / far) ** 3 * np.where(there, 0.3 + 0.4 * inner(places), table * (0.5 + around(places)))

    lamps = random.uniform(-200, 200, (count, 2))
    return [seen_plane(camera, lambda at, lamp=lamp: value(lamp, at)) for lamp in lamps]


@pytest.fixture(scope="module")
def camera():
    pytest.importorskip("cv2", reason="OpenCV is not installed")
    return looking_camera((320, 240), 400, 400, tilt=25, around=200, roll=8)


def test_a_homography_of_exact_points_is_exact():
    matrix = np.array([(1.2, 0.1, 30), (-0.2, 0.9, -12), (3e-4, -2e-4, 1)])
    points = np.random.default_rng(0).uniform(-100, 100, (7, 2))
    np.testing.assert_allclose(homography(points, mapped(matrix, points)), matrix, rtol=1e-9)


def test_a_card_is_found_to_a_third_of_a_pixel(camera):
    found = find_corners(capture_of(camera, card_pictures(camera, [((0, 0), _CARD)])))
    true = from_upper_left(camera, _AROUND * _CARD)
    assert np.linalg.norm(np.array(found.corners) - true, axis=1).max() < 0.35
    assert found.photographs == found.read == 3 and found.board is None and found.width is None


def test_the_search_yields_before_each_look_at_a_picture(camera):
    looks = []
    capture = capture_of(camera, card_pictures(camera, [((0, 0), _CARD)]))
    shots = tuple(replace(shot, read=lambda read=shot.read: looks.append(1) or read()) for shot in capture.observations)
    parts = [(part, len(looks)) for part in corner_steps(replace(capture, observations=shots))]
    assert [read for _, read in parts[:4]] == [0, 1, 2, 3]  # three pictures, and two of them together
    assert len(parts) == 4 + 5 + 2 + 3  # markers in each, outlines in both, the outline fitted to each
    done = [part for part, _ in parts]
    assert done == sorted(done) and done[0] >= 0 and done[-1] <= 1


def test_two_cards_of_one_size_are_refused(camera):
    pictures = card_pictures(camera, [((-45, 0), (30, 40)), ((45, 0), (30, 40))])
    with pytest.raises(CaptureError, match="several rectangles of about one size"):
        find_corners(capture_of(camera, pictures))


def test_a_table_without_a_card_is_refused(camera):
    with pytest.raises(CaptureError, match="neither printed markers nor one rectangle"):
        find_corners(capture_of(camera, card_pictures(camera, [], table=0.4)))


def test_a_card_that_moves_between_photographs_is_refused(camera):
    places = [(-4, 0), (0, 4), (4, -4)]
    pictures = [card_pictures(camera, [(place, _CARD)], count=1)[0] for place in places]
    with pytest.raises(CaptureError, match="photographs agree on it"):
        find_corners(capture_of(camera, pictures))


def board_value(board, dpi=150):
    """Return places (…, 2) → values of the printed marker board on a grey table."""
    ink = np.asarray(board_picture(board, dpi).convert("L"), float) / 255
    size = np.array(PAPERS[board.paper])

    def value(places):
        at = np.floor((places * (1, -1) + size / 2) / size * ink.shape[::-1]).astype(int)
        inside = ((at >= 0) & (at < ink.shape[::-1])).all(axis=-1)
        at = np.clip(at, 0, np.array(ink.shape[::-1]) - 1)
        return np.where(inside, 0.05 + 0.75 * ink[at[..., 1], at[..., 0]], 0.2)

    return value


def test_a_printed_board_gives_the_corners_and_the_width_of_its_field(camera):
    board = board_of("letter", 8)
    wide = looking_camera((480, 400), 560, 520, tilt=25, around=70, roll=-95)
    capture = capture_of(wide, [seen_plane(wide, board_value(board))])
    found = find_corners(capture)
    true = from_upper_left(wide, board.field_corners)
    assert np.linalg.norm(np.array(found.corners) - true, axis=1).max() < 0.5
    assert found.board == board and found.width == pytest.approx(135.9)
    # The distance follows: the turned camera looks straight at the field, as far from its plane as this one is.
    part = framed(capture, Framing(corners=AUTO))
    assert part.card_distance == pytest.approx(wide.position[2], rel=0.01)
    assert framed(capture, Framing(corners=AUTO, card_width=10.0)).card_distance == pytest.approx(
        wide.position[2] / 13.59, rel=0.01
    )


def test_nothing_is_printed_where_a_board_has_bare_paper():
    for board in BOARDS:
        ink, (width, height) = np.asarray(board_picture(board, 254).convert("L")), PAPERS[board.paper]
        column, row = np.round(10 * (board.white * (1, -1) + (width / 2, height / 2))).astype(int).T
        assert len(board.white) > 60
        for x, y in zip(column, row, strict=True):
            assert (ink[y - 15 : y + 16, x - 15 : x + 16] == 255).all(), (board.name, x, y)


def test_no_number_is_on_two_boards():
    numbers = [number for board in BOARDS for number in board.markers]
    assert len(set(numbers)) == len(numbers) and max(numbers) < 50


def test_a_board_has_its_true_size_and_replaces_no_file(tmp_path):
    pytest.importorskip("cv2", reason="OpenCV is not installed")
    from PIL import Image

    path = tmp_path / "board.png"
    write_board(board_of("A4", 4), path)
    with Image.open(path) as picture:
        inches = np.array(picture.size) / picture.info["dpi"]
    np.testing.assert_allclose(inches * 25.4, (210, 297), atol=0.05)
    with pytest.raises(InputError, match="choose another name"):
        write_board(board_of("A4", 4), path)
    with pytest.raises(InputError, match=r"neither .pdf nor .png"):
        write_board(board_of("A4", 4), tmp_path / "board.svg")


def test_corners_auto_is_a_value_of_table_and_command_line(tmp_path):
    rows = 'corners = "auto"\n[[camera]]\n[[observation]]\nimage = "a.exr"\nlight_direction = [0, 0, 1]\n'
    (tmp_path / "capture.toml").write_text(rows)
    assert read_spec(tmp_path).framing.corners == AUTO
    (tmp_path / "capture.toml").write_text(rows.replace("auto", "found"))
    with pytest.raises(CaptureError, match='must be "auto", or a list'):
        read_spec(tmp_path)
    options = build_parser().parse_args(["recover", "x", "-o", "y", "--corners", "auto"])
    assert options.corners == AUTO
