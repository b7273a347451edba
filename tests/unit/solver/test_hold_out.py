"""What --hold-out asks for, the order in which what is held out is read, and the line that tells how it was relit."""

import numpy as np
import pytest

from irpso_addon.capture.types import Capture, LeftOut, Light, Observation
from irpso_addon.commands.options.hold_out import held_out_list
from irpso_addon.core.errors import InputError
from irpso_addon.results.preview import PreviewRow
from irpso_addon.solver.views.held_out import MIN_OBSERVATIONS, _figures, distinct_names, order_of, relit_line, spared

NAMES = [f"IMG_000{k}.jpg" for k in range(1, 6)]


@pytest.mark.parametrize(
    ("count", "chosen"),
    [(5, [4]), (8, [4]), (16, [4, 12]), (24, [4, 12, 20]), (48, [4, 12, 20, 28, 36, 44]),
     (72, [6, 18, 30, 42, 54, 66]), (1000, [83, 250, 417, 584, 751, 918])],
)  # fmt: skip
def test_auto_holds_out_one_in_eight_evenly_spaced_and_at_most_six(count, chosen):
    assert held_out_list("auto", [f"{k}.jpg" for k in range(count)]) == chosen


def test_of_four_observations_none_can_be_spared():
    with pytest.raises(InputError, match="--hold-out auto: of 4 observations none can be held out; omit the option"):
        held_out_list("auto", NAMES[:4])


@pytest.mark.parametrize(
    ("text", "chosen"),
    [
        (None, []), ("3,0", [3, 0]), ("IMG_0003,IMG_0001.jpg, 4", [2, 0, 4]),
        ("12", [5]), ("12.png", [5]), ("x.jpg,x.png", [6, 7]), ("x", [8]),
    ],
)  # fmt: skip
def test_an_entry_is_a_full_name_else_a_stem_else_a_number(text, chosen):
    assert held_out_list(text, [*NAMES, "12.png", "x.jpg", "x.png", "x", *"abcdef"]) == chosen


@pytest.mark.parametrize("text", ["left, low.jpg,b.jpg", "b,left, low", "1, left, low.jpg"])
def test_a_name_may_contain_commas(text):
    assert sorted(held_out_list(text, ["left, low.jpg", "b.jpg", "left.jpg"])) == [0, 1]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("IMG_0004,IMG_003", "'IMG_003' is no photograph; the nearest names are IMG_0003.jpg, .*; numbers are from 0"),
        ("sunset", "'sunset' is no photograph; the first names are IMG_0001.jpg, IMG_0002.jpg, IMG_0003.jpg; numbers"),
        ("auto,3", "'auto' is no photograph"), ("-1", "'-1' is no photograph"), ("7", "numbers are from 0 to 6"),
        ("1,,2", "'' is no photograph"), ("3,3", "--hold-out 3,3: gives IMG_0004.jpg twice"),
        ("0,IMG_0001", "gives IMG_0001.jpg twice; give different photographs"),
        ("x", r"'x' may be x.jpg \(number 5\), x.png \(number 6\); give the full name, or the number"),
    ],
)  # fmt: skip
def test_unknown_ambiguous_and_repeated_photographs_are_refused(text, words):
    with pytest.raises(InputError, match=words):
        held_out_list(text, [*NAMES, "x.jpg", "x.png"])


def test_names_of_left_out_photographs_keep_their_place():
    shots = tuple(Observation(name, np.zeros, Light((0.0, 0.0, 1.0))) for name in "ac")
    left_out = (LeftOut(1, "/photos/b.jpg", "is cut short"), LeftOut(3, "/photos/d.jpg", "is missing"))
    assert Capture("a", shots, (), (), left_out=left_out).listed_names == ["a", "b.jpg", "c", "d.jpg"]


def test_photographs_of_one_name_are_named_by_their_number():
    assert distinct_names(["cam1/1.jpg", "1.jpg", "2.jpg", "1.jpg"], [0, 1, 5, 7]) == [
        "cam1/1.jpg", "1.jpg (number 1)", "2.jpg", "1.jpg (number 7)",
    ]  # fmt: skip


def test_numbers_of_a_capture_count_the_left_out_photographs():
    shots = tuple(Observation(name, np.zeros, Light((0.0, 0.0, 1.0))) for name in "ac")
    capture = Capture("a", shots, (), (), left_out=(LeftOut(1, "b.jpg", "is cut short"),))
    assert capture.listed_numbers == [0, 2] and capture.numbers(capture.listed_numbers) == [0, 1]


def test_the_least_number_for_holding_out_is_right():
    assert spared([0] * MIN_OBSERVATIONS) and not spared([0] * (MIN_OBSERVATIONS - 1))


@pytest.mark.parametrize(("lamps", "cameras"), [(8, 4), (16, 3), (24, 2), (40, 3)])
def test_cameras_that_list_the_same_lamps_do_not_lose_one_lamp_in_all_views(lamps, cameras):
    chosen = spared([k // lamps for k in range(lamps * cameras)])
    assert len({k % lamps for k in chosen}) == len(chosen) and len({k // lamps for k in chosen}) == cameras


@pytest.mark.parametrize(("few", "seen"), [(9, False), (10, True)])
def test_highlights_of_a_few_texels_are_noise_and_no_figure(few, seen):
    dark = np.zeros((40, 50, 3))
    row = PreviewRow("a", dark, dark + 0.1, np.zeros((40, 50)), covered=np.ones((40, 50), bool))
    found = _figures(["a"], [row], [np.arange(2000).reshape(40, 50) < few])
    assert found["relighting_psnr_db"] == {"a": 20.0}
    assert found["relighting_highlights_psnr_db"] == {"a": 20.0 if seen else None}
    assert found["relighting_highlights_mean_psnr_db"] == (20.0 if seen else None)


def test_held_out_images_are_read_last_in_the_named_order():
    assert order_of(6, [4, 1]) == [0, 2, 3, 5, 4, 1] and order_of(3, []) == [0, 1, 2]


@pytest.mark.parametrize(
    ("psnr", "highlights", "line"),
    [
        (33.456, 30.149, "Unseen photographs: RMS error 2.1% (33.5 dB), in highlights 3.1% (30.1 dB)"),
        (33.456, None, "Unseen photographs: RMS error 2.1% (33.5 dB)"),
        (None, None, "Unseen photographs: nothing to compare"),
    ],
)
def test_one_line_reports_the_means(psnr, highlights, line):
    assert relit_line({"relighting_mean_psnr_db": psnr, "relighting_highlights_mean_psnr_db": highlights}) == line
    assert relit_line({}) == ""
