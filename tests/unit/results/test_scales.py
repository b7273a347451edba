"""Round limits, ticks and their labels."""

import math

import numpy as np
import pytest

from irpso_addon.results.scales import linear_ticks, log_ticks, round_down, round_up, steady_limit, tick_text, ticks_to


@pytest.mark.parametrize(
    ("value", "above", "below"),
    [(1.0, 1, 1), (1.01, 2, 1), (0.03, 0.05, 0.02), (0.5, 0.5, 0.5), (7, 10, 5), (1e-5, 1e-5, 1e-5), (999, 1000, 500)],
)
def test_limits_are_one_two_or_five_times_a_power_of_ten(value, above, below):
    assert round_up(value) == pytest.approx(above)
    assert round_down(value) == pytest.approx(below)


def test_a_limit_holds_while_the_error_falls_a_little_and_changes_seldom_over_a_run():
    limit, shown = 0.0, []
    rng = np.random.default_rng(1)
    for error in np.geomspace(0.2, 0.002, 400):
        limit = steady_limit(4 * error * rng.uniform(0.95, 1.05), limit)
        shown.append(limit)
    assert all(limit == pytest.approx(round_up(limit)) for limit in set(shown))
    assert steady_limit(0.21, 0.0) == 0.2 and steady_limit(0.4, 0.0) == 0.5
    changes = np.count_nonzero(np.diff(shown))
    assert 3 <= changes <= 8
    assert np.count_nonzero(np.diff(shown) > 0) == 0
    assert steady_limit(math.nan, 0.2) == 0.2


@pytest.mark.parametrize(
    ("low", "high", "most"), [(0, 1, 6), (0, 5, 6), (0, 0.02, 6), (0, 130, 5), (0, 7000, 4), (-1, 1, 5)]
)
def test_linear_ticks_are_round_even_and_not_too_many(low, high, most):
    ticks = linear_ticks(low, high, most)
    assert 2 <= len(ticks) <= most
    assert low <= ticks[0] and ticks[-1] <= high * (1 + 1e-9)
    step = ticks[1] - ticks[0]
    assert np.allclose(np.diff(ticks), step)
    assert step == pytest.approx(round_up(step))
    assert np.allclose(np.array(ticks) / step, np.rint(np.array(ticks) / step))


@pytest.mark.parametrize(
    ("top", "ticks"), [(50, [0, 50]), (20, [0, 10, 20]), (0.1, [0, 0.05, 0.1]), (35, [0, 10, 20, 30])]
)
def test_a_legend_always_labels_its_top(top, ticks):
    assert ticks_to(top, 4) == pytest.approx(ticks)


def test_log_ticks_label_decades_and_mark_the_numbers_between():
    major, minor = log_ticks(0.02, 20)
    assert major == pytest.approx([0.1, 1, 10])
    assert minor == pytest.approx([*np.arange(2, 10) * 0.01, *np.arange(2, 10) * 0.1, *np.arange(2, 10), 20])
    assert log_ticks(0.2, 5)[0] == pytest.approx([0.2, 0.5, 1, 2, 5])
    assert len(log_ticks(1e-8, 1)[0]) <= 6


def test_numbers_at_ticks_are_short():
    assert [tick_text(v) for v in (0, 0.1 + 0.2, 10.0, 2500.0, 0.002, 1e-6, 3.0)] == [
        "0", "0.3", "10", "2500", "0.002", "1e-6", "3",
    ]  # fmt: skip


@pytest.mark.parametrize("top", [150_000, 220_000, 1_000_000, 2.2e-5, 4e-9])
def test_each_tick_shows_its_own_number(top):
    ticks = linear_ticks(0, top, 6)
    np.testing.assert_allclose([float(tick_text(tick)) for tick in ticks], ticks, rtol=1e-9)
