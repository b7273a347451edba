"""The progress bar: what it says of the time left."""

import pytest

from irpso_addon.core import progress_bar
from irpso_addon.core.progress_bar import ProgressBar


@pytest.mark.parametrize(("extrapolated", "said"), [(True, "6:15 left"), (False, "")])
def test_a_time_left_that_the_caller_does_not_know_is_extrapolated_only_on_request(
    monkeypatch, capsys, extrapolated, said
):
    clock = iter([0.0, 0.0, 125.0, 130.0])
    monkeypatch.setattr(progress_bar.time, "perf_counter", lambda: next(clock))
    bar = ProgressBar("recover", extrapolated=extrapolated)
    bar.show(0.0)
    bar.show(0.25)  # 125 s for a quarter
    bar.show(0.5, left=61.0)
    _, second, third = capsys.readouterr().err.splitlines()
    assert second.rpartition("%")[2].strip() == said
    assert third.endswith("1:01 left")
