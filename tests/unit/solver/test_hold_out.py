"""What --hold-out asks for, the order in which what is held out is read, and the line that tells how it was relit."""

import pytest

from irpso_addon.commands.options.values import held_out_list
from irpso_addon.core.errors import InputError
from irpso_addon.solver.views.held_out import FEWEST_SPARING, order_of, relit_line, spared


@pytest.mark.parametrize(
    ("count", "chosen"),
    [(5, [4]), (8, [4]), (16, [4, 12]), (24, [4, 12, 20]), (48, [4, 12, 20, 28, 36, 44]),
     (72, [6, 18, 30, 42, 54, 66]), (1000, [83, 250, 417, 584, 751, 918])],
)  # fmt: skip
def test_auto_holds_out_one_in_eight_evenly_spaced_and_at_most_six(count, chosen):
    assert held_out_list("auto", count) == chosen


def test_of_four_observations_none_can_be_spared():
    with pytest.raises(InputError, match="--hold-out auto: of 4 observations none can be held out; omit the option"):
        held_out_list("auto", 4)


@pytest.mark.parametrize("text", ["auto,3", "3,3", "-1", "16"])
def test_anything_else_is_a_list_of_numbers(text):
    assert held_out_list(None, 16) == [] and held_out_list("3,0", 16) == [3, 0]
    with pytest.raises(InputError, match="--hold-out .*: give different numbers from 0 to 15"):
        held_out_list(text, 16)


def test_the_least_number_for_holding_out_is_right():
    assert spared(FEWEST_SPARING) and not spared(FEWEST_SPARING - 1)


def test_held_out_images_are_read_last_in_the_named_order():
    assert order_of(6, [4, 1]) == [0, 2, 3, 5, 4, 1] and order_of(3, []) == [0, 1, 2]


@pytest.mark.parametrize(
    ("psnr", "highlights", "line"),
    [
        (33.456, 30.149, "Unseen photographs: 33.5 dB, highlights 30.1 dB"),
        (33.456, None, "Unseen photographs: 33.5 dB"),
        (None, None, "Unseen photographs: nothing to compare"),
    ],
)
def test_one_line_reports_the_means(psnr, highlights, line):
    assert relit_line({"relighting_mean_psnr_db": psnr, "relighting_highlights_mean_psnr_db": highlights}) == line
    assert relit_line({}) == ""
