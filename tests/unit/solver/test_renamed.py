"""Former names of settings: read from presets of earlier formats, elsewhere refused with the new."""

import json
import re

import pytest

from irpso_addon.core.errors import InputError
from irpso_addon.core.paths import PRESETS
from irpso_addon.solver.settings.schedule import SETTINGS, load_schedule

FORMER = {  # table → former name → present name and a value that no preset has
    "swarm": {
        "seed": ("start", "given"), "seeded": ("start_fraction", 0.375), "seed_spread": ("start_spread", 0.75),
        "linear_reach": ("linear_limit", 5.0), "c3_until": ("c3_fade", 0.875),
        "neighbour_every": ("neighbour_interval", 77),
    },
    "fitness": {"percentile": ("scale_percentile", 61.0), "bounds": ("clipped_samples", False)},
    "prefit": {"observations": ("min_observations", 19)},
    "refinement": {
        "votes": ("neighbour_weight", 2.5), "central": ("central_differences", True), "widening": ("delta_factor", 9.0),
        "race_observations": ("race_max_observations", 21),
    },
    "prior": {
        "likeness": ("bandwidth", 0.45), "likeness_color": ("color_bandwidth", 0.55), "spread": ("min_deviation", 0.35),
        "noise_freedom": ("noise_samples", 33.0), "share": ("min_influence", 0.65), "turn": ("normals", False),
    },
}  # fmt: skip
EVERY = [(table, old, *now) for table, names in FORMER.items() for old, now in names.items()]


def full(table, name):
    """Return a setting's name as in ``--set``."""
    return name if table in ("swarm", "fitness") else f"{table}_{name}"


def text_of(tables, version):
    """Return a preset that extends swarm. tables: name → key → value."""
    lines = [f"format = {version}", 'extends = "swarm"']
    for table, values in tables.items():
        lines += [f"[{table}]", *(f"{key} = {json.dumps(value)}" for key, value in values.items())]
    return "\n".join(lines)


def loaded(tmp_path, text):
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return load_schedule(path)


def test_a_preset_of_format_2_is_read_under_the_present_names(tmp_path):
    tables = {table: {old: value for old, (_, value) in names.items()} for table, names in FORMER.items()}
    tables["fitness"]["loss"] = "robust"
    found = loaded(tmp_path, text_of(tables, 2)).settings()
    assert {full(table, now): found[full(table, now)] for table, _, now, _ in EVERY} == {
        full(table, now): value for table, _, now, value in EVERY
    }
    assert found["loss"] == "cauchy"


def test_a_whole_preset_of_format_2_is_the_present_one(tmp_path):
    text = (PRESETS / "standard.toml").read_text(encoding="utf-8").replace('"cauchy"', '"robust"')
    text = text.replace("format = 3", "format = 2").replace("[prefit]", "[prefit]\nmin_observations = 10")
    for _, old, now, _ in EVERY:
        text = re.sub(rf"^{now} =", f"{old} =", text, flags=re.M)
    assert 'seed = "lambert"' in text and "votes = 6.0" in text and "min_observations" not in text
    assert loaded(tmp_path, text).settings() == load_schedule("standard").settings()


def test_a_preset_without_a_format_is_of_the_first(tmp_path):
    text = 'extends = "standard"\n[survey]\npolish_iterations = 7\njudge_delta = 0.25\ntrust = 2.0\nobservations = 12\n'
    text += "[polish]\ndaring = 3.0\ngain = 0.5\nsmallest_step = 0.75\nvotes = 1.5\nrounds = 2\n"
    found = loaded(tmp_path, text)
    prefit, refinement = found.prefit, found.refinement
    assert (prefit.refinement_iterations, prefit.acceptance_delta, prefit.acceptance_ratio) == (7, 0.25, 2.0)
    assert (refinement.candidate_ratio, refinement.ftol, refinement.xtol) == (3.0, 0.5, 0.75)
    assert (prefit.min_observations, refinement.neighbour_weight, refinement.rounds) == (12, 1.5, 2)
    assert prefit.iterations == load_schedule("standard").prefit.iterations


@pytest.mark.parametrize("version", [0, 4, '"3"'])
def test_a_preset_of_another_format_is_refused(tmp_path, version):
    with pytest.raises(
        InputError, match=r"mine\.toml: is of format ['3-40]+; this version reads 1 to 3: install a later"
    ):
        loaded(tmp_path, text_of({}, version))


@pytest.mark.parametrize(("table", "old", "now", "value"), EVERY)
def test_a_former_name_is_refused_with_the_present_one(tmp_path, table, old, now, value):
    was, present = full(table, old), full(table, now)
    assert present in SETTINGS and was not in SETTINGS
    with pytest.raises(InputError, match=f"there is no setting '{was}'; it is '{present}' now$"):
        load_schedule("swarm").replaced(**{was: value})
    with pytest.raises(
        InputError, match=rf"mine\.toml: \[{table}\]: unknown key '{old}'; it is '{now}' now; known are"
    ):
        loaded(tmp_path, text_of({table: {old: value}}, 3))
    with pytest.raises(InputError, match=f"unknown key '{old}'; it is '{now}' now"):  # one of the two would be lost
        loaded(tmp_path, text_of({table: {old: value, now: value}}, 2))


def test_former_values_and_tables_are_refused_with_the_present_ones(tmp_path):
    with pytest.raises(InputError, match="loss must be one of l1, l2, cauchy, not 'robust'; it is 'cauchy' now"):
        load_schedule("swarm").replaced(loss="robust")
    with pytest.raises(InputError, match=r"unknown key 'polish'; it is 'refinement' now"):
        loaded(tmp_path, text_of({"polish": {"iterations": 3}}, 3))
