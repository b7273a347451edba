"""What benchmarks/gloss.py counts as covered by the reported deviations."""

import numpy as np
import pytest

pytest.importorskip("scipy", reason="the cards are made with scipy")

from benchmarks.gloss import outlier_shares  # noqa: E402
from irpso_addon.blender.scenes.true_surface import TrueMaps  # noqa: E402
from irpso_addon.capture.images.exr import write_exr  # noqa: E402

pytestmark = pytest.mark.bpy_only


def maps(red):
    flat = np.zeros((2, 4))
    colour = np.stack([np.full((2, 4), red), flat, flat], axis=-1)
    return TrueMaps(colour, np.tile([0.0, 0.0, 1.0], (2, 4, 1)), flat, flat)


def test_colour_errors_use_their_own_channels_deviation_at_seen_texels_only(tmp_path):
    small, large = np.full((2, 4), 0.01, np.float32), np.full((2, 4), 1.0, np.float32)
    seen = np.zeros((2, 4), bool)
    seen[0, :2] = True
    half = np.where(np.arange(4) < 1, small, large)  # of the seen texels the first is wrong beyond its deviation
    write_exr(tmp_path / "confidence.exr", {"confidence_base_color": {"R": half, "G": small, "B": large}})
    shares = outlier_shares(maps(0.5), maps(0.0), seen, tmp_path)
    assert shares["beyond_base_color"] == 0.5
    assert shares["beyond_roughness"] is None
    write_exr(tmp_path / "confidence.exr", {"confidence_base_color": {"R": large, "G": small, "B": small}})
    assert outlier_shares(maps(0.5), maps(0.0), seen, tmp_path)["beyond_base_color"] == 0
