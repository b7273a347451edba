"""GPU textures, and their exact transfer from and to numpy arrays."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Protocol

import numpy as np

from ..core.errors import InputError

CHANNELS = {"R32F": 1, "RG32F": 2, "RGBA32F": 4, "RGBA16F": 4}
_FORMATS = {1: "R32F", 2: "RG32F", 4: "RGBA32F"}


class Texture(Protocol):
    """Blender's gpu.types.GPUTexture. format: a key of CHANNELS."""

    width: int
    height: int
    format: str

    def clear(self, *, format: str, value: tuple[float, ...]) -> None: ...

    def read(self) -> Any: ...


def upload(array: np.ndarray) -> Texture:
    """Return a float32 texture of an array (H, W) or (H, W, C) with C of 1, 2, 3 or 4 (3 gains a zero channel)."""
    array = _padded(array[..., None] if array.ndim == 2 else array)
    height, width, channels = array.shape
    return _texture(width, height, format=_FORMATS[channels], data=_buffer(array))


def upload_layers(array: np.ndarray, texture_format: str = "RGBA32F") -> Texture:
    """Return an array texture of (K, H, W, 4) float32: K layers, read in shaders as FLOAT_2D_ARRAY."""
    layers, height, width, _ = array.shape
    array = np.ascontiguousarray(array, np.float32)
    return _texture(width, height, layers=layers, format=texture_format, data=_buffer(array))


def empty(width: int, height: int, texture_format: str = "RGBA32F", value: float | None = None) -> Texture:
    """Return a texture cleared to ``value``, or with undefined contents for None."""
    texture = _texture(width, height, format=texture_format)
    if value is not None:
        texture.clear(format="FLOAT", value=(value,) * CHANNELS[texture_format])
    return texture


def download(texture: Texture) -> np.ndarray:
    """Return a copy of a float texture as (H, W, C) float32."""
    channels = CHANNELS[texture.format]
    return _array(texture.read(), (texture.height, texture.width, channels))


def texels(texture: Texture, places: Iterable[tuple[int, int]]) -> np.ndarray:
    """Return (n, C) float32 of a float texture at n places (x, y): some microseconds each, at any texture size."""
    import gpu

    channels = CHANNELS[texture.format]
    framebuffer = gpu.types.GPUFrameBuffer(color_slots=[texture])
    with framebuffer.bind():
        read = [framebuffer.read_color(int(x), int(y), 1, 1, channels, 0, "FLOAT") for x, y in places]
    return np.array([_array(buffer, (channels,)) for buffer in read], np.float32).reshape(-1, channels)


def _texture(width: int, height: int, layers: int = 0, **properties: Any) -> Texture:
    """Return a new texture. Raises InputError where the GPU refuses it, as settings may exceed its memory."""
    import gpu

    try:
        texture: Texture = gpu.types.GPUTexture((width, height), layers=layers, **properties)
        return texture
    except RuntimeError as error:
        size = f"{width} × {height}" + (f" × {layers}" if layers else "")
        raise InputError(
            f"the GPU refuses a texture of {size} texels; choose a smaller --resolution, fewer particles, or smaller or"
            " fewer images"
        ) from error


def _array(buffer: Any, shape: tuple[int, ...]) -> np.ndarray:
    # Up to Blender 5.0 a multi-dimensional Buffer has transposed strides: flatten it before numpy sees it.
    buffer.dimensions = int(np.prod(shape))
    return np.frombuffer(buffer, np.float32).reshape(shape).copy()


def _buffer(array: np.ndarray) -> Any:
    import gpu

    return gpu.types.Buffer("FLOAT", array.size, array.ravel())


def _padded(array: np.ndarray) -> np.ndarray:
    array = np.asarray(array, np.float32)
    if array.shape[-1] == 3:
        array = np.concatenate([array, np.zeros((*array.shape[:-1], 1), np.float32)], axis=-1)
    return np.ascontiguousarray(array)
