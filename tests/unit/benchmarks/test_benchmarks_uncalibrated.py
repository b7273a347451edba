"""How far found lights are off: against lights that are turned and scaled on purpose."""

import numpy as np
import pytest

pytest.importorskip("scipy.ndimage", reason="scipy is not installed: the scenes' scores use it")

from benchmarks.uncalibrated import light_errors


def rotated(vectors, degrees):
    """Turn (K, 3) about the axis z."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return vectors @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])


def made():
    rng = np.random.default_rng(4)
    directions = rng.normal(size=(30, 3)) + (0, 0, 1.5)
    return directions / np.linalg.norm(directions, axis=1, keepdims=True), rng.uniform(0.5, 2, 30)


def test_a_common_rotation_and_a_common_factor_are_taken_off():
    directions, strengths = made()
    found = light_errors((directions, strengths), (rotated(directions, 5), 3 * strengths))
    sine = np.hypot(directions[:, 0], directions[:, 1])
    expected = 2 * np.degrees(np.arcsin(sine * np.sin(np.radians(2.5))))  # of each, by its distance from the axis
    assert found["lights"] == pytest.approx(expected.mean(), rel=1e-6)
    assert found["turned"] < 1e-4 and found["strengths"] < 1e-12


def test_what_lights_do_not_share_stays():
    directions, strengths = made()
    other = directions.copy()
    other[::2] = rotated(directions[::2], 4)
    other[1::2] = rotated(directions[1::2], -4)
    uneven = strengths * np.where(np.arange(30) < 20, 1, 1.3)
    found = light_errors((directions, strengths), (other, uneven))
    assert 0.5 * found["lights"] < found["turned"] <= found["lights"]
    assert found["strengths"] == pytest.approx(0.3 / 3)
