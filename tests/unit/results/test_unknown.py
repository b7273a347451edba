"""Texels of which a parameter is unknown, by cause."""

from dataclasses import replace

import numpy as np

from irpso_addon.reflectance.model import load_model
from irpso_addon.results.maps import Cause, Maps, split_maps

MODEL = load_model("metallic_roughness")
SHAPE = (2, 4)


def maps_of(roughness, everything=()):
    """Maps with a known normal and specular. roughness: its deviations in the first row; everything: texels as wide."""
    values = {p.name: np.full((*SHAPE, p.components), 0.5, np.float32) for p in MODEL.parameters}
    sigma = {p.name: np.full((*SHAPE, 1 if p.is_normal else p.components), 0.01) for p in MODEL.parameters}
    sigma["roughness"][0, :, 0] = roughness
    for texel in everything:
        for p in MODEL.parameters:
            sigma[p.name][texel] = np.float32(p.width)
    sigma["specular"][:] = 0  # fixed
    return Maps(MODEL, values, np.ones(SHAPE, bool), confidence=sigma)


def test_a_texel_is_unknown_for_its_first_cause():
    first, second = (np.zeros(SHAPE, bool) for _ in range(2))
    first[0, :2] = second[:, 1:] = True
    maps = replace(
        maps_of([1.0, 0.4, 0.4, 0.01], everything=[(0, 0), (0, 2)]), two_modes={"roughness": second},
        unknown_texels={"roughness": {Cause.MOSTLY_INDIRECT: first}},
    )  # fmt: skip
    causes = maps.unknown_by_cause()
    found = {cause: np.argwhere(mask).tolist() for cause, mask in causes["roughness"].items()}
    assert found == {
        Cause.MOSTLY_INDIRECT: [[0, 0], [0, 1]], Cause.NOTHING_DETERMINED: [[0, 2]], Cause.WIDE_DEVIATION: [],
        Cause.TWO_MODES: [[0, 3], [1, 1], [1, 2], [1, 3]],
    }  # fmt: skip
    assert causes["normal"][Cause.NOTHING_DETERMINED].sum() == 2
    np.testing.assert_array_equal(maps.unknown()["roughness"], sum(causes["roughness"].values()) > 0)
    ((_, part),) = split_maps(maps)
    assert part.unknown_texels["roughness"][Cause.MOSTLY_INDIRECT].shape == SHAPE


def test_a_wide_deviation_of_one_number_is_no_sign_that_nothing_is_determined():
    causes = maps_of([1.0, 0.3, 0.2, 0.01]).unknown_by_cause()["roughness"]
    assert causes[Cause.WIDE_DEVIATION][0].tolist() == [True, True, False, False]
    assert not causes[Cause.NOTHING_DETERMINED].any()


def test_texels_that_are_not_solved_are_not_unknown():
    maps = replace(maps_of(1.0), solved=np.zeros(SHAPE, bool), unknown_texels={"normal": {Cause.LATER_ROUND: np.True_}})
    assert not any(mask.any() for masks in maps.unknown_by_cause().values() for mask in masks.values())
