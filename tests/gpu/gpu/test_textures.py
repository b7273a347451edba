"""Arrays go up to the GPU and come down bit for bit, whatever their size and channels."""

from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.errors import InputError
from irpso_addon.gpu import context, textures
from irpso_addon.gpu.kernel import Kernel, Output
from irpso_addon.gpu.passes import Pass
from irpso_addon.solver.kernels.single_passes import copy_pass

pytestmark = pytest.mark.usefixtures("gpu")

KERNELS = Path(__file__).parents[1] / "kernels"
SIZES = [(1, 1), (1, 7), (7, 1), (13, 17), (64, 33), (3, 1025)]


def numbers(*shape):
    """Return float32 of every magnitude that is not subnormal, signs and zeros of both kinds among them."""
    rng = np.random.default_rng(sum(shape))
    values = (rng.normal(size=shape) * 10.0 ** rng.integers(-30, 30, size=shape)).astype(np.float32)
    special = np.array([0.0, -0.0, np.inf, -np.inf, 1.0, np.float32(3.4e38), np.float32(1.2e-38)], np.float32)
    values.ravel()[: special.size] = special[: values.size]
    return values


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize("channels", [None, 1, 2, 3, 4])
def test_an_array_comes_back_bit_for_bit(size, channels):
    array = numbers(*size) if channels is None else numbers(*size, channels)
    found = textures.download(textures.upload(array))
    wanted = array[..., None] if channels is None else array
    if channels == 3:
        assert not found[..., 3].any()
        found = found[..., :3]
    assert found.dtype == np.float32 and found.shape == wanted.shape
    assert np.ascontiguousarray(found).tobytes() == wanted.tobytes()


def test_other_array_types_are_converted():
    values = numbers(6, 4, 4)
    for array in (values[::-1], values[:, ::2], np.asfortranarray(values), values.transpose(1, 0, 2)):
        np.testing.assert_array_equal(textures.download(textures.upload(array)), array)
    whole = np.arange(24).reshape(2, 3, 4)
    np.testing.assert_array_equal(textures.download(textures.upload(whole)), whole)
    np.testing.assert_array_equal(textures.download(textures.upload(whole / 3)), (whole / 3).astype(np.float32))


def test_an_upload_does_not_follow_its_array():
    array = np.ones((5, 5, 4), np.float32)
    texture = textures.upload(array)
    array[:] = 2
    assert (textures.download(texture) == 1).all()


def test_a_download_does_not_follow_its_texture():
    texture = textures.empty(4, 3, value=1.0)
    before = textures.download(texture)
    texture.clear(format="FLOAT", value=(2.0,) * 4)
    assert (before == 1).all() and (textures.download(texture) == 2).all()


@pytest.mark.parametrize(("name", "channels"), textures.CHANNELS.items())
def test_an_empty_texture_is_cleared_in_every_channel(name, channels):
    found = textures.download(textures.empty(5, 3, name, value=-0.5))
    assert found.shape == (3, 5, channels) and (found == -0.5).all()


@pytest.mark.parametrize(("layers", "size"), [(1, (1, 1)), (2, (5, 3)), (33, (13, 17)), (200, (7, 9))])
def test_every_layer_of_an_array_texture_is_read_where_it_was_put(layers, size):
    array = numbers(layers, *size, 4)
    array[~np.isfinite(array)] = 5
    texture = textures.upload_layers(array)
    target = textures.empty(size[1], size[0])
    kernel = Kernel(
        KERNELS / "layers.glsl", (Output("o_value"),), {"u_layers": "FLOAT_2D_ARRAY"}, {"u_layer": "INT"}, {}
    )
    work = Pass(kernel)
    for layer in sorted({0, 1 % layers, layers // 2, layers - 1}):
        work.run([target], {"u_layers": texture}, {"u_layer": layer})
        np.testing.assert_array_equal(textures.download(target), array[layer])
    work.close()


def test_a_copy_pass_copies_bit_for_bit():
    copy = copy_pass()
    array = numbers(13, 17, 4)
    target = textures.empty(17, 13)
    copy.run([target], {"u_source": textures.upload(array)})
    assert textures.download(target).tobytes() == array.tobytes()
    copy.close()


def test_a_refused_texture_names_its_size_and_the_remedy():
    width = 2 * context.max_texture_size()
    with pytest.raises(InputError, match=rf"refuses a texture of {width} × 4 texels; choose a smaller --resolution"):
        textures.empty(width, 4)
