"""Error measures and the report against numbers worked out by hand."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.reflectance.model import Parameter, ReflectanceModel, load_model
from irpso_addon.results.maps import Maps
from irpso_addon.results.report import build_report, limit_warnings, parameter_error, plain, quantiles
from irpso_addon.solver.views.pictures import confidence_preview

NORMAL = Parameter("normal", 3, (-1, 1), (0, 0, 1), map="normal", is_normal=True)
GLOSS = Parameter("gloss", 2, (0.0, 4.0), (1, 1), map="gloss")
MODEL = ReflectanceModel("mine", "Mine", Path("mine.glsl"), (NORMAL, GLOSS))


def test_the_angle_between_normals_is_exact_where_they_nearly_agree():
    angle = np.radians(1e-5)
    values = np.array([[[0, 0, 1.0], [1, 0, 0]]])
    truth = np.array([[[np.sin(angle), 0, np.cos(angle)], [0, 1, 0]]])
    np.testing.assert_allclose(parameter_error(NORMAL, values, truth), [[1e-5, 90]], rtol=1e-6)


def test_a_truth_without_a_normal_gives_no_error_number():
    assert np.isnan(parameter_error(NORMAL, np.array([[[0, 0, 1.0]]]), np.zeros((1, 1, 3)))).all()


def test_other_errors_are_a_mean_absolute_difference_in_percent_of_the_range():
    error = parameter_error(GLOSS, np.array([[[1.0, 2.0]]]), np.array([[[1.2, 2.2]]]))
    np.testing.assert_allclose(error, [[5.0]])


def test_quantiles_leave_out_what_is_not_a_number():
    numbers = quantiles(np.array([np.nan, *range(101)]))
    assert numbers == {"mean": 50.0, "median": 50.0, "p90": 90.0, "p99": 99.0, "max": 100.0, "count": 101}
    assert quantiles(np.array([np.nan]))["mean"] is None


def albedo_maps(share: float) -> Maps:
    """Return maps of 100 covered texels, that share of which has a channel at the limit, beside 100 others at it."""
    albedo = Parameter("albedo", 3, (0.0, 1.0), (0.5, 0.5, 0.5), kind="linear", map="albedo")
    values = np.full((2, 100, 3), (0.2, 0.5, 0.1))
    values[0, : round(100 * share), 1] = values[1] = 1
    covered = np.repeat([[True], [False]], 100, axis=1)
    return Maps(ReflectanceModel("mine", "Mine", Path("mine.glsl"), (NORMAL, albedo)), {"albedo": values}, covered)


def test_an_albedo_at_its_limit_is_warned_of_with_its_share_of_the_covered_texels():
    (line,) = limit_warnings(albedo_maps(0.4))
    assert "albedo is at its limit 1 on 40% of the texels" in line


def test_few_texels_at_the_limit_or_a_fixed_albedo_give_no_warning():
    assert limit_warnings(albedo_maps(0.05)) == []
    assert limit_warnings(albedo_maps(0.4), fixed={"albedo"}) == []


def test_the_weight_of_a_lobe_at_its_limit_is_no_albedo():
    model = load_model("cook_torrance_two_lobe")
    values = {p.name: np.broadcast_to(np.float32(p.default), (2, 2, p.components)) for p in model.parameters}
    maps = Maps(model, values | {"w": np.ones((2, 2, 1), np.float32)}, np.ones((2, 2), bool))
    assert limit_warnings(maps) == []


@pytest.fixture
def report():
    covered = np.ones((4, 5), bool)
    covered[0] = False
    evaluated = np.ones((4, 5), bool)
    evaluated[:, 0] = False
    normal = np.zeros((4, 5, 3), np.float32)
    normal[..., 2] = 1
    residual = np.where(evaluated, 0.25, 9.0)
    maps = Maps(MODEL, {"normal": normal, "gloss": np.full((4, 5, 2), 1.0)}, covered, residual)
    truth = {"gloss": np.full((4, 5, 2), 1.4), "unknown": np.zeros((4, 5, 1))}
    return build_report(
        maps, settings={"preset": "swarm", "lights": np.arange(3)}, seed=7, gpu="a GPU", iterations=10,
        evaluations=1000, seconds={"solve": 1.23456}, ground_truth=truth, evaluated=evaluated, noise=2.5 / 255,
    )  # fmt: skip


def test_errors_are_taken_over_evaluated_texels_and_the_excluded_fraction_is_stated(report):
    assert report["residual"]["max"] == 0.25
    assert report["noise_codes"] == 2.5
    assert report["residual"]["count"] == 12
    assert report["excluded_fraction"] == pytest.approx(3 / 15)
    assert report["ground_truth"]["gloss"]["unit"] == "%"
    assert report["ground_truth"]["gloss"]["mean"] == pytest.approx(10)
    assert set(report["ground_truth"]) == {"gloss"}


def test_the_report_is_json_and_names_its_versions(report):
    again = json.loads(json.dumps(report, allow_nan=False))
    assert again["settings"] == {"preset": "swarm", "lights": [0, 1, 2]}
    assert (again["seed"], again["gpu"], again["size"], again["texels"]) == (7, "a GPU", [5, 4], 15)
    assert {"irpso", "python", "numpy", "openexr"} <= set(again["versions"])
    assert again["seconds"] == {"solve": 1.235}


def test_plain_data_hold_no_nan_and_no_paths():
    assert plain({"a": float("nan"), "b": Path("x"), "c": (np.float32(0.5), None)}) == {
        "a": None,
        "b": "x",
        "c": [0.5, None],
    }


def test_unknown_numbers_are_counted_and_striped():
    model, shape = load_model("metallic_roughness"), (20, 30)
    values = {p.name: np.full((*shape, p.components), 0.5, np.float32) for p in model.parameters}
    sigma = {p.name: np.zeros((*shape, 1 if p.is_normal else p.components), np.float32) for p in model.parameters}
    sigma["metallic"][:, :12] = 0.26  # of a range of 1
    sigma["roughness"][:5] = 0.24  # of a range of 0.98
    sigma["normal"][:2] = 0.4  # of π/2
    sigma["base_color"][:] = 0.9  # no searched number: an uncertain colour is that of a sure metal, too
    covered = np.ones(shape, bool)
    covered[:, 28:] = covered[:, :2] = False
    maps = Maps(model, values, covered, np.zeros(shape, np.float32), sigma)
    made = build_report(maps, settings={}, seed=0, gpu="none", iterations=1, evaluations=1, seconds={})
    assert "noise_codes" not in made
    assert made["unknown"] == {"normal": 0.1, "roughness": 0.0, "metallic": round(10 / 26, 4), "specular": 0.0}
    striped = confidence_preview(maps)["confidence"]
    sure = confidence_preview(replace(maps, confidence={name: 0 * s for name, s in sigma.items()}))["confidence"]
    orange = np.isclose(striped, (0.93, 0.45, 0.12), atol=0.02).all(axis=-1)
    assert orange.mean() > 0.01 and not np.isclose(sure, (0.93, 0.45, 0.12), atol=0.02).all(axis=-1).any()
    assert confidence_preview(replace(maps, confidence=None)) == {}
