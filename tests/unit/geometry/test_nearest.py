"""Nearest neighbours: against all distances."""

import numpy as np
import pytest

from irpso_addon.geometry import nearest as module
from irpso_addon.geometry.nearest import nearest


def surface(count, seed=0):
    u, v = np.random.default_rng(seed).random((2, count))
    return np.stack([u, v, 0.2 * np.sin(6 * u) * np.cos(5 * v)], axis=-1).astype(np.float32)


def lattice(side):
    """Points of which many are equally far from others."""
    y, x = np.mgrid[:side, :side]
    places = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3).astype(np.float32)
    return np.random.default_rng(1).permutation(places)


@pytest.mark.parametrize("points", [surface(1500), lattice(38), lattice(12) * 0, surface(9), surface(1)])
@pytest.mark.parametrize("share", [0.03, 0.5])
def test_the_nearest_of_all_is_found_and_the_first_of_equals(points, share):
    others = points[: max(1, int(share * len(points)))]
    x, y, z = ((points[:, None, i] - others[:, i]) ** 2 for i in range(3))
    np.testing.assert_array_equal(nearest(points, others), (x + y + z).argmin(axis=1))


def test_far_fewer_distances_are_computed_than_there_are_pairs(monkeypatch):
    counted, squared = [], module._squared

    def counting(a, b):
        result = squared(a, b)
        counted.append(result.size)
        return result

    monkeypatch.setattr(module, "_squared", counting)
    totals = []
    for count in (2000, 32000):
        counted.clear()
        nearest(surface(count), surface(count, 1))
        totals.append(sum(counted))
    assert totals[1] < 40 * totals[0] < 256 * totals[0]  # of 16 times as many points
    assert max(counted) < 2**23
