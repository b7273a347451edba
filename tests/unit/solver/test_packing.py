"""Dense packing of the texels that are solved."""

import numpy as np
import pytest

from irpso_addon.solver.state.packing import Packing

RNG = np.random.default_rng(0)
MASKS = {
    "everywhere": np.ones((5, 7), bool),
    "nowhere": np.zeros((5, 7), bool),
    "one": np.eye(5, 7, 3, bool) & (np.arange(7) == 4),
    "some": RNG.random((13, 17)) < 0.3,
    "a row": RNG.random((1, 29)) < 0.7,
    "all but one": np.arange(35).reshape(5, 7) != 11,
}


@pytest.mark.parametrize("name", MASKS)
def test_packing_and_unpacking_restores_texels_and_fills_the_rest(name):
    mask = MASKS[name]
    packing = Packing(mask)
    array = RNG.normal(size=(*mask.shape, 3)).astype(np.float32)
    unpacked = packing.unpack(packing.pack(array), (7, 8, 9))
    np.testing.assert_array_equal(unpacked[mask], array[mask])
    np.testing.assert_array_equal(unpacked[~mask], np.broadcast_to((7, 8, 9), ((~mask).sum(), 3)))


@pytest.mark.parametrize("name", MASKS)
def test_empty_texels_take_no_space_except_in_the_last_row(name):
    mask = MASKS[name]
    packing = Packing(mask)
    assert packing.width * packing.height - mask.sum() < max(packing.width, 2)
    if mask.all():
        assert (packing.height, packing.width) == mask.shape


def test_places_are_those_of_the_inverse_and_of_solved_texels_alone():
    solved = np.random.default_rng(2).random((9, 13)) < 0.6
    packing = Packing(solved)
    rows, columns = (found[::-3] for found in np.nonzero(solved))
    np.testing.assert_array_equal(packing.places(rows, columns), packing.arrays()[1][rows, columns])
    row, column = np.argwhere(~solved)[-1]
    with pytest.raises(ValueError, match=f"texel \\({column}, {row}\\) is not solved"):
        packing.places(np.array([row]), np.array([column]))
