"""PNG files that several threads compress, read back by a reader of the tests."""

import numpy as np
import pytest

from irpso_addon.core import png
from tests.builders.captures import read_png


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_blocks_make_one_stream_of_the_same_pixels(monkeypatch, tmp_path, channels, bits):
    codes = np.random.default_rng(bits + channels).integers(0, 2**bits, (37, 29, channels))
    codes[1:] = codes[0]  # blocks refer to the rows before them
    whole = png.png_bytes(codes[::-1] / (2**bits - 1), bits)
    monkeypatch.setattr(png, "_BLOCK", 500)
    parts = png.png_bytes(codes[::-1] / (2**bits - 1), bits)
    for data in (whole, parts):
        (tmp_path / "a.png").write_bytes(data)
        back, depth = read_png(tmp_path / "a.png")
        assert depth == bits
        np.testing.assert_array_equal(back, codes)
    assert parts != whole
