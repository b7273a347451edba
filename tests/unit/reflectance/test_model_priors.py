"""What a model believes of its parameters: read from its table, refused where it cannot be, told in the report."""

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.errors import InputError
from irpso_addon.core.paths import MODELS
from irpso_addon.reflectance.model import ParameterPrior, load_model
from irpso_addon.results.maps import Maps
from irpso_addon.results.report import photograph_shares, prior_shares
from irpso_addon.solver.settings.schedule import load_schedule


def model_with(tmp_path, prior, parameter="specular"):
    """The path of principled's table with a line for one parameter's prior."""
    text = (MODELS / "principled.toml").read_text(encoding="utf-8")
    (tmp_path / "mine.toml").write_text(
        text.replace(f'name = "{parameter}"\n', f'name = "{parameter}"\nprior = {prior}\n'), encoding="utf-8"
    )
    (tmp_path / "mine.glsl").write_text((MODELS / "principled.glsl").read_text(encoding="utf-8"), encoding="utf-8")
    return tmp_path / "mine.toml"


def test_a_prior_is_read(tmp_path):
    path = model_with(tmp_path, '{ kind = "concave", value = 1, width = 0.2, vanishes_with = "roughness" }')
    assert load_model(path).parameter("specular").prior == ParameterPrior("concave", 1.0, 0.2, "roughness")
    assert load_model("principled").parameter("specular").prior is None


@pytest.mark.parametrize(
    ("prior", "parameter", "message"),
    [
        ("0.5", "specular", "prior: write prior = "),
        ('{ kind = "normal", value = 0.5 }', "specular", "prior: write prior = "),
        ('{ kind = "normal", value = 0.5, width = 0.1, why = "so" }', "specular", "prior: write prior = "),
        ('{ kind = "cauchy", value = 0.5, width = 0.1 }', "specular", "kind must be one of normal, concave"),
        ('{ kind = "normal", value = 1.5, width = 0.1 }', "specular", "value must be .* inside the range"),
        ('{ kind = "normal", value = nan, width = 0.1 }', "specular", "value must be a number"),
        ('{ kind = "normal", value = true, width = 0.1 }', "specular", "value must be a number"),
        ('{ kind = "normal", value = 0.5, width = 0 }', "specular", "width must be a number above 0, not 0"),
        ('{ kind = "normal", value = 0.5, width = inf }', "specular", "width must be a number above 0"),
        ('{ kind = "concave", value = 0.5, width = 0.1 }', "specular", "an end of the range"),
        ('{ kind = "normal", value = 0.5, width = 0.1 }', "base_color", "only a searched parameter"),
        ('{ kind = "normal", value = 0.5, width = 0.1 }', "normal", "only a searched parameter"),
        ('{ kind = "normal", value = 0.5, width = 0.1, vanishes_with = "specular" }', "specular", "another scalar"),
        ('{ kind = "normal", value = 0.5, width = 0.1, vanishes_with = ["x"] }', "specular", "another scalar: rough"),
    ],
)  # fmt: skip
def test_an_invalid_prior_is_refused_in_one_line(tmp_path, prior, parameter, message):
    with pytest.raises(InputError, match=message) as refused:
        load_model(model_with(tmp_path, prior, parameter))
    assert "mine.toml" in str(refused.value) and f"'{parameter}'" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_model_can_be_loaded_without_some_priors():
    model = load_model("metallic_roughness")
    assert {p.name for p in model.parameters if p.prior} == {"roughness", "metallic", "specular"}
    assert {p.name for p in model.without_priors(["specular"]).parameters if p.prior} == {"roughness", "metallic"}


def test_the_variance_of_a_prior_follows_its_curvature_or_gradient():
    normal = ParameterPrior("normal", 0.5, 0.1, "roughness")
    np.testing.assert_allclose(normal.variance(np.array([0.0, 0.9]), 1.0), [0.01, 0.01])
    np.testing.assert_allclose(
        normal.variance(np.zeros(3), 1.0, np.array([0, 0.5, 1])), 0.01 * np.array([1, 0.75, 0.02]) ** 2
    )
    concave = ParameterPrior("concave", 0.0, 0.1)
    np.testing.assert_allclose(concave.variance(np.array([0.0, 0.5, 1.0]), 1.0), [0.01, 0.04, np.inf])


def test_the_report_counts_texels_dominated_by_the_prior():
    model, shape = load_model("metallic_roughness").without_priors({"roughness"}), (2, 3)
    values = {p.name: np.full((*shape, p.components), p.default, np.float32) for p in model.parameters}
    values["metallic"][1] = 1.0
    confidence = {p.name: np.zeros((*shape, 1), np.float32) for p in model.parameters}
    # Of a prior of width 0.1 a deviation of 0.08 leaves 0.64 of the variance to it, one of 0.06 no more than 0.36.
    confidence["specular"][:, :2], confidence["specular"][:, 2:] = 0.08, 0.06
    confidence["metallic"][:] = 1.0
    covered = np.array([[True, True, True], [False, True, True]])
    maps = Maps(model, values, covered, confidence=confidence)
    # No prior draws at a metal: it does not decide there.
    assert prior_shares(maps) == {"metallic": 0.6, "specular": 0.6}
    assert prior_shares(maps, fixed={"metallic"}) == {"specular": 0.6}
    assert prior_shares(replace(maps, confidence=None)) == {}
    # Metallic is unknown where its prior does not decide; of specular a modest deviation remains there.
    assert photograph_shares(maps) == {"metallic": 0.0, "specular": 0.4}
    modes = replace(maps, two_modes={"specular": np.array([[False] * 3, [False, False, True]])})
    assert photograph_shares(modes)["specular"] == 0.2


def test_standard_uses_priors_and_paper_does_not():
    assert load_schedule("standard").fitness.priors and not load_schedule("paper").fitness.priors
