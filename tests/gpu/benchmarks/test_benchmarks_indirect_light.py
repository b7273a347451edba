"""Light that hollow bodies throw on themselves: what is gathered and what Cycles bakes are what Cycles renders."""

import pytest

from benchmarks import indirect_light

pytestmark = pytest.mark.bpy_only


def test_gathered_and_baked_light_are_the_rendered_light_of_a_matt_bowl(tmp_path):
    rows = indirect_light.rows("bowl, 0.6", True, [16], tmp_path)
    assert [row[1] for row in rows] == ["gather, 3 bounces", "gather, 8 bounces", "bake, 16 samples"]
    for _, way, _, ratio, error in rows:
        assert abs(float(ratio) - 1) < 0.05, way
        assert int(error.removesuffix(" %")) < 45, way  # noise: pictures of 40 × 40 pixels, 4 samples each
