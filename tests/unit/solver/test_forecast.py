"""The search time that is foreseen."""

import numpy as np
import pytest

from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.planning.cost import recovery_cost
from irpso_addon.solver.planning.forecast import forecast, forecast_text
from irpso_addon.solver.settings.schedule import load_schedule

QUIET = {"renderer": "llvmpipe (LLVM 15.0.6, 256 bits)", "fragment_seconds": 0.06, "compute_seconds": 0.05}


def work_of(texels, observations, preset="standard"):
    return texels * recovery_cost(load_model("metallic_roughness"), load_schedule(preset), (), observations).work


def test_a_card_that_took_91_seconds_on_a_quiet_machine_lies_in_the_foreseen_range():
    low, high = forecast(work_of(58077, 96), QUIET)
    assert low < 90.7 < high < 4 * low


def test_time_grows_with_texels_rounds_and_a_slower_device_and_less_than_with_photographs():
    work = work_of(1000, 50)
    assert work_of(3000, 50) == pytest.approx(3 * work)
    assert work_of(1000, 50, "thorough") == pytest.approx(4 * work)
    assert 1 < work_of(1000, 100) / work < 2
    # What a device of no time leaves is the host's part, which is the same beside a slower one.
    host, quick, slow = (np.array(forecast(work, QUIET | {"fragment_seconds": s})) for s in (1e-30, 0.06, 0.6))
    assert slow - host == pytest.approx(10 * (quick - host))


def test_matte_rounds_of_a_mesh_and_the_full_round_that_may_follow_are_foreseen():
    model, standard = load_model("metallic_roughness"), load_schedule("standard")

    def cost(schedule, known_shape=True):
        return recovery_cost(model, schedule, (), 40, known_shape=known_shape)

    alone, matte = cost(standard.without_rounds()), cost(standard)
    assert alone.work == alone.most_work
    assert 1.02 * alone.work < matte.work < 1.3 * alone.work
    assert 1.4 * matte.work < matte.most_work < 2.2 * matte.work
    full = cost(standard.replaced(interreflection_rounds=1))
    assert full.work == full.most_work == matte.most_work
    card = cost(standard, known_shape=False)  # has no matte rounds
    assert card.work == card.most_work == alone.work
    sure, possible = (forecast(1e9, QUIET, most) for most in (None, 2e9))
    assert possible == pytest.approx((sure[0], 2 * sure[1]))


def test_on_a_fast_gpu_the_hosts_part_is_foreseen():
    """Of an H100 docs/benchmarks/gpu.md has 12.0 s; 7.6 of them were work of the host that the GPU does since."""
    h100 = {"renderer": "NVIDIA H100", "fragment_seconds": 2.8e-4, "compute_seconds": 5.8e-5}
    low, high = forecast(work_of(1 << 20, 24), h100)
    assert low < 4.4 < high


def test_a_gpu_counts_with_the_passes_that_it_will_use():
    data_centre = {"renderer": "NVIDIA H100", "fragment_seconds": 0.3, "compute_seconds": 0.01}
    assert forecast(1e9, data_centre) == forecast(1e9, QUIET | {"fragment_seconds": 0.01})


@pytest.mark.parametrize(
    ("seconds", "words"),
    [((10, 30), "less than a minute"), ((20, 65), "1 to 2 minutes"), ((100, 350), "2 to 6 minutes"),
     ((2400, 7800), "1 to 2 hours"), ((11000, 35000), "3 to 10 hours")],
)  # fmt: skip
def test_a_range_is_told_in_round_numbers(seconds, words):
    assert forecast_text(seconds) == words
