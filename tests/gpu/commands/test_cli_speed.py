"""``doctor --benchmark``: what it says a recovery takes, beside recoveries that are timed by themselves."""

import json
import re

import pytest

from irpso_addon.pipeline import speed
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.engine.recovery import Recovery
from irpso_addon.solver.settings.schedule import load_schedule
from tests.builders.command_line import run_cli

SIDE = 24


@pytest.fixture(scope="module")
def card():
    return speed.make_card(load_model("metallic_roughness"), SIDE)


def test_the_card_can_be_recovered(card):
    """A benchmark of a recovery that finds nothing would time something else."""
    assert card.solvable.all() and card.observations == 24
    with Recovery(card, load_model("metallic_roughness"), load_schedule("standard")) as recovery:
        progress = recovery.step()
        residual = recovery.maps().residual
    assert residual.mean() < 0.01 * card.stack.values[..., :3].mean()
    assert progress.done


def test_the_phases_are_those_of_a_recovery_and_their_renders_its_evaluations(card):
    model, schedule = load_model("metallic_roughness"), load_schedule("standard")
    with Recovery(card, model, schedule) as recovery:
        titles = [recovery.progress.title]
        while not recovery.step(1).done:
            if recovery.progress.title != titles[-1]:
                titles.append(recovery.progress.title)
        evaluations = recovery.progress.evaluations
    phases = list(speed._timed(card, model, schedule))
    assert [phase.title for phase in phases] == titles
    assert sum(phase.renders for phase in phases) == evaluations * 24
    assert all(phase.seconds > 0 for phase in phases)


def test_doctor_prints_it_and_other_captures_by_it(monkeypatch):
    monkeypatch.setattr(speed, "_SIDE", {True: SIDE, False: SIDE})
    code, out, _ = run_cli("doctor", "--benchmark")
    assert code == 0 and f"measured      {SIDE**2} texels, 24 photographs, metallic_roughness, standard" in out
    assert re.search(r"refinement +\d+\.\d\d +\d+\.\d% +\d+\.\d\n", out)
    assert re.search(r"twelve megapixels +12\.00 M texels × 24 +\d+ to \d+ (minutes|hours) +\d+\.\d GiB\n", out)
    code, out, _ = run_cli("doctor", "--benchmark", "--json")
    found = json.loads(out)["benchmark"]
    assert found["texels"] == SIDE**2 and found["upload_bytes_per_second"] > 0
    low, high = found["captures"]["twelve megapixels"]["seconds"]
    search = sum(phase["seconds"] for phase in found["phases"].values())
    assert low < search * 12e6 / SIDE**2 < high, "as many photographs: the time is in proportion to the texels"
    more = found["captures"]["the same under 96 lights"]
    assert low < more["seconds"][0] < 4 * low  # four times the samples, of which each has less of the rest
    assert more["device_bytes"] > 1.5 * found["captures"]["twelve megapixels"]["device_bytes"]


def test_doctor_measures_nothing_unasked(monkeypatch):
    monkeypatch.setattr("irpso_addon.commands.doctor.measure_speed", lambda: pytest.fail("it measured"))
    code, out, _ = run_cli("doctor", "--json")
    assert code == 0 and "benchmark" not in json.loads(out)
