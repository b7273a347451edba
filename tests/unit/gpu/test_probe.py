"""What the probe of a GPU says where it fails, without a GPU."""

import subprocess

import numpy as np
import pytest

from irpso_addon.core.errors import GpuUnavailableError
from irpso_addon.gpu import probe


@pytest.mark.parametrize(("wrong", "other"), [("fragment", "compute"), ("compute", "fragment")])
def test_a_gpu_that_computes_wrongly_is_refused_with_what_to_do(wrong, other, monkeypatch):
    right = np.ones((2, 2))
    monkeypatch.setattr(probe, "_expected", lambda: right)
    monkeypatch.setattr(probe, "_run", lambda entry: (right + 0.25 * (entry == wrong), 1.0))
    with pytest.raises(GpuUnavailableError) as caught:
        probe.check()
    text = str(caught.value)
    assert f"this GPU computes wrongly: the {wrong} probe is off by 0.25; " in text
    assert "update its driver" in text and f"--entry {other} (Passes, in the preferences)" in text


def test_a_probe_without_an_answer_is_refused_with_what_to_do(monkeypatch):
    def run(command, **options):
        raise subprocess.TimeoutExpired(command, options["timeout"])

    monkeypatch.setattr(subprocess, "run", run)
    with pytest.raises(GpuUnavailableError, match=r"did not answer in 120 s; close other programs .*update its driver"):
        probe.probe()
