"""Interchangeable lobes, against the float64 oracle's radiance."""

import numpy as np
import pytest

from irpso_addon.reflectance.model import load_model
from tests.oracles import reflectance as oracles

TWO_LOBES = ["cook_torrance_two_lobe", "principled_two_lobe"]


@pytest.mark.parametrize("name", TWO_LOBES)
def test_lobes_are_put_in_rising_order_without_changing_the_radiance(name):
    model, rng = load_model(name), np.random.default_rng(0)
    values = {p.name: rng.uniform(*p.range, (6, 7, p.components)) for p in model.parameters if not p.is_normal}
    values["normal"] = np.broadcast_to((0.0, 0.0, 1.0), (6, 7, 3))
    found = model.with_ordered_lobes(values)
    first, second = model.ordered
    assert (values[first] > values[second]).any() and (found[first] <= found[second]).all()
    light, view = (oracles.unit(np.array(v)) for v in ((0.3, 0.2, 1.0), (-0.2, 0.1, 1.0)))
    flat = ({n: v[..., 0] if v.shape[-1] == 1 else v for n, v in maps.items()} for maps in (values, found))
    before, after = (oracles.MODELS[name](maps, light, view) for maps in flat)
    np.testing.assert_allclose(after, before, rtol=1e-12)


def test_maps_without_all_numbers_of_the_lobes_are_unchanged():
    model = load_model(TWO_LOBES[0])
    values = {"r1": np.full((2, 2, 1), 0.6), "r2": np.full((2, 2, 1), 0.2)}
    assert model.with_ordered_lobes(values) == values
    assert load_model("lambert").with_ordered_lobes(values) == values
