"""The sets of lights that the benchmark tries are those whose figures inspect speaks from."""

import numpy as np
import pytest

pytest.importorskip("scipy.ndimage", reason="scipy is not installed: interreflection is blurred by it")

from benchmarks import lights
from irpso_addon.capture.inspect import sufficiency


@pytest.mark.parametrize("degrees", lights.CONES)
def test_a_cone_has_the_half_angle_it_is_named_after(degrees):
    found = lights.cone(lights.SPREAD_OVER, degrees)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1)
    outermost = np.degrees(np.arccos(found[:, 2].min()))
    assert 0.97 * degrees < outermost < degrees
    assert sufficiency.half_angle(found) == pytest.approx(degrees, rel=0.01)


@pytest.mark.parametrize("width", lights.FANS)
def test_a_fan_has_the_width_it_is_named_after(width):
    found = lights.fan(lights.SPREAD_OVER, width)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1)
    assert found[:, 1].std() / found[:, 0].std() == pytest.approx(width, rel=0.05)
    assert sufficiency.spread_across(found) == pytest.approx(width, rel=0.05)


def test_every_figure_of_inspect_is_of_a_set_that_the_benchmark_tries():
    assert {f.value for f in sufficiency.NUMBER} <= set(lights.COUNTS)
    assert {f.value for f in sufficiency.CONE} <= set(lights.CONES)
    assert {f.value for f in sufficiency.ACROSS} <= set(lights.FANS)


def test_the_page_says_when_inspects_figures_are_not_those_measured():
    def rows(off):
        return [
            {"kind": "number", "value": f.value, "degradation": "dirty", "model": "principled",
             "failed": {"normal": f.failed[0], "roughness": min(f.failed[1] + off, 1)}}
            for f in sufficiency.NUMBER
        ]  # fmt: skip

    assert lights._outdated(rows(0.0)) == []
    assert "number 10, roughness: 16.7% there, 26.7% here" in lights._outdated(rows(0.1))[0]


@pytest.mark.parametrize("figure", sufficiency.NUMBER, ids=lambda figure: f"{figure.value} lights")
def test_inspect_calls_lights_enough_where_few_of_the_measured_texels_failed(figure):
    # Spread over the whole sphere, so that nothing but their number speaks against them.
    fact, findings = lights.inspect_lights(lights.lights_of("number", figure.value))
    # Five lights did worse than three by chance: nothing is enough below what was not.
    failed = np.array([f.failed for f in sufficiency.NUMBER if f.value >= figure.value]).max(axis=0)
    wanted = [goal for goal, part in zip(sufficiency.GOALS, failed, strict=True) if part <= sufficiency.FEW]
    said = fact.split("; ")[0].split(", ") if not fact.startswith("not") else []
    assert said == wanted
    assert len(findings) == len(sufficiency.GOALS) - len(wanted)
