"""Starts in a model's table: where a refinement begins besides the estimate."""

import pytest

from irpso_addon.core.errors import InputError
from irpso_addon.core.paths import MODELS
from irpso_addon.reflectance.model import load_model, shipped_models


def model_with(tmp_path, rows):
    text = (MODELS / "principled.toml").read_text(encoding="utf-8")
    (tmp_path / "mine.toml").write_text(text.split("[[start]]")[0] + rows, encoding="utf-8")
    (tmp_path / "mine.glsl").write_text((MODELS / "principled.glsl").read_text(encoding="utf-8"), encoding="utf-8")
    return tmp_path / "mine.toml"


def test_a_start_sets_some_parameters_by_name(tmp_path):
    rows = "[[start]]\nroughness = 0.2\n\n[[start]]\nspecular = 1\nbase_color = [0.1, 0.2, 0.3]\n"
    starts = load_model(model_with(tmp_path, rows)).starts
    assert starts == ((("roughness", (0.2,)),), (("specular", (1.0,)), ("base_color", (0.1, 0.2, 0.3))))


def test_a_start_may_turn_the_normal_to_the_mirror_direction(tmp_path):
    rows = '[[start]]\nroughness = 0.2\nnormal = "mirror"\n'
    assert load_model(model_with(tmp_path, rows)).starts == ((("roughness", (0.2,)), ("normal", ())),)


def test_a_model_need_not_have_starts(tmp_path):
    assert load_model(model_with(tmp_path, "")).starts == () == load_model("lambert").starts


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("[start]\nroughness = 0.2\n", "starts are written .*two brackets"),
        ("[[start]]\n", "set at least one parameter"),
        ("[[start]]\ngloss = 0.2\n", "'gloss' is no parameter; set base_color, normal, roughness, specular"),
        ("[[start]]\nnormal = [0, 0, 1]\n", 'normal: a normal begins at "mirror"'),
        ("[[start]]\nroughness = 1.5\n", "roughness must be one number, or one a component, inside the range"),
        ("[[start]]\nbase_color = [0.1, 0.2]\n", "base_color must be one number, or one a component"),
    ],
)
def test_an_invalid_start_is_refused(tmp_path, rows, message):
    with pytest.raises(InputError, match=message):
        load_model(model_with(tmp_path, rows))


@pytest.mark.parametrize("name", shipped_models())
def test_lobes_of_shipped_starts_are_in_rising_order(name):
    model = load_model(name)
    for start in map(dict, model.starts):
        assert not model.ordered or start[model.ordered[0]] < start[model.ordered[1]]
