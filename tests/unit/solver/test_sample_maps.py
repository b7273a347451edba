"""Maps sampled at texture coordinates, against scipy's interpolation of each UDIM tile alone."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from irpso_addon.solver.views.forward import sampled


@pytest.mark.parametrize(("tiles", "size"), [(1, (5, 7)), (2, (8, 8)), (3, (4, 1))])
def test_each_tile_ends_at_its_own_border(tiles, size):
    height, width = size
    rng = np.random.default_rng(tiles)
    colour = rng.uniform(size=(height, width * tiles, 3)).astype(np.float32)
    uv = np.stack(np.meshgrid(np.linspace(0.001, 0.999, 64), np.linspace(0.001, 0.999, 21)), axis=-1)
    found = sampled({"base_color": colour}, uv, tiles)["base_color"]
    tile = (uv[..., 0] * tiles).astype(int)
    for number in range(tiles):
        part, at = colour[:, number * width : (number + 1) * width], tile == number
        places = uv[at][:, 1] * height - 0.5, (uv[at][:, 0] * tiles - number) * width - 0.5
        for channel in range(3):
            expected = map_coordinates(part[..., channel], places, order=1, mode="nearest")
            np.testing.assert_allclose(found[at][:, channel], expected, atol=1e-5)
