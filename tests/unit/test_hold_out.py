"""What --hold-out asks for."""

import pytest

from irpso_addon.commands.options import held_out_list
from irpso_addon.errors import InputError


@pytest.mark.parametrize(
    ("count", "chosen"),
    [(5, [4]), (8, [4]), (16, [4, 12]), (24, [4, 12, 20]), (48, [4, 12, 20, 28, 36, 44]),
     (72, [6, 18, 30, 42, 54, 66]), (1000, [83, 250, 417, 584, 751, 918])],
)  # fmt: skip
def test_auto_spares_one_in_eight_evenly_spaced_and_six_at_most(count, chosen):
    assert held_out_list("auto", count) == chosen


def test_of_four_observations_none_can_be_spared():
    with pytest.raises(InputError, match="--hold-out auto: of 4 observations none can be spared; leave it out"):
        held_out_list("auto", 4)


@pytest.mark.parametrize("text", ["auto,3", "3,3", "-1", "16"])
def test_anything_else_is_a_list_of_numbers(text):
    assert held_out_list(None, 16) == [] and held_out_list("3,0", 16) == [3, 0]
    with pytest.raises(InputError, match="--hold-out .*: give different numbers from 0 to 15"):
        held_out_list(text, 16)
