"""Numbers that a whole material leaves open between two values: who decides, and what is said of it."""

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.reflectance.model import load_model
from irpso_addon.results.maps import Maps
from irpso_addon.results.report import build_report, mode_warnings
from irpso_addon.solver.engine import modes
from irpso_addon.solver.engine.modes import with_modes

MODEL = load_model("metallic_roughness")
SHAPE = (30, 40)


def maps_of(worse, left=20, shape=SHAPE):
    """Maps of a blue material, ``left`` columns wide, and a red one. worse: of the roughness, what broadcasts."""
    values = {p.name: np.full((*shape, p.components), 0.5, np.float32) for p in MODEL.parameters}
    values["base_color"][:] = (0.9, 0.1, 0.1)
    values["base_color"][:, :left] = (0.1, 0.1, 0.9)
    sigma = {p.name: np.zeros((*shape, 1 if p.is_normal else p.components), np.float32) for p in MODEL.parameters}
    worse_map = np.broadcast_to(np.float32(worse), shape)[..., None]
    alternatives = {"roughness": worse_map, "metallic": np.full_like(worse_map, 9.0)}
    return Maps(MODEL, values, np.ones(shape, bool), np.zeros(shape, np.float32), sigma, alternatives=alternatives)


def of_halves(left, right):
    """Deviances of the blue half and of the red one."""
    return np.where(np.arange(SHAPE[1]) < 20, left, right)


def of_few(worse):
    """Deviances of the first column, and 5 elsewhere."""
    return np.where(np.arange(SHAPE[1]) < 1, worse, 5.0)


def test_forty_texels_of_a_material_must_contradict_by_three_deviations():
    for mean, two in ((0.2, True), (0.25, False)):
        found = with_modes(maps_of(of_halves(mean, 5.0))).two_modes
        assert (found["roughness"][:, :20] == two).all() and not found["roughness"][:, 20:].any()
        assert not found["metallic"].any()


def test_few_informative_texels_decide_for_their_own_material():
    worse = np.zeros(SHAPE)
    worse[:, 0] = 9.0  # one in twenty of the blue ones
    found = with_modes(maps_of(worse)).two_modes["roughness"]
    assert not found[:, :20].any() and found[:, 20:].all()


def test_a_better_alternative_is_a_second_mode():
    assert with_modes(maps_of(-5.0)).two_modes["roughness"].all()


def test_fewer_texels_than_forty_count_as_many_as_they_are():
    for worse, two in ((0.25, True), (0.35, False)):  # 30 texels: 7.5, 10.5
        assert (with_modes(maps_of(of_few(worse), 1)).two_modes["roughness"][:, 0] == two).all()


def test_texels_outside_count_nothing_and_have_no_modes():
    worse = np.where(np.arange(SHAPE[0])[:, None] < 15, 0.0, 9.0)
    maps = maps_of(worse)
    covered = maps.solved.copy()
    covered[15:] = False
    found = with_modes(replace(maps, solved=covered)).two_modes["roughness"]
    assert found[:15].all() and not found[15:].any()


def test_texels_are_gathered_in_parts_to_the_same_end(monkeypatch):
    worse = np.random.default_rng(1).normal(0.225, 0.5, SHAPE)
    whole = with_modes(maps_of(worse)).two_modes
    monkeypatch.setattr(modes, "_AT_ONCE", 70)
    for name, value in with_modes(maps_of(worse)).two_modes.items():
        np.testing.assert_array_equal(value, whole[name])


@pytest.mark.parametrize("alternatives", [None, {}])
def test_unmeasured_maps_stay_unchanged(alternatives):
    maps = replace(maps_of(0.0), alternatives=alternatives)
    assert with_modes(maps) is maps and maps.two_modes == {} and mode_warnings(maps, True) == []
    nothing = replace(maps_of(0.0), solved=np.zeros(SHAPE, bool))
    assert with_modes(nothing) is nothing


def test_two_modes_are_unknown_in_the_report_and_warned_of_where_they_are_many():
    marked = with_modes(maps_of(of_halves(0.0, 5.0)))
    report = build_report(marked, settings={}, seed=0, gpu="none", iterations=1, evaluations=1, seconds={})
    assert report["two_modes"] == {"roughness": 0.5, "metallic": 0.0}
    assert report["unknown"] == {"normal": 0.0, "roughness": 0.5, "metallic": 0.0, "specular": 0.0}
    assert report["unknown_causes"] == {"normal": {}, "roughness": {"two_modes": 0.5}, "metallic": {}, "specular": {}}
    (line,) = mode_warnings(marked, True)
    assert line.startswith("roughness of 50% of the texels has two possible values")
    assert "the prior decided" in line and "the prior decided" not in mode_warnings(marked, False)[0]
    few = with_modes(maps_of(of_few(0.0), 1))
    assert 0 < few.two_modes["roughness"].mean() < 0.05 and mode_warnings(few, True) == []
    before = maps_of(0.0)
    assert "two_modes" not in build_report(
        before, settings={}, seed=0, gpu="none", iterations=1, evaluations=1, seconds={}
    )
