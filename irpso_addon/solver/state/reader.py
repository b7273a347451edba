"""Downloads of textures that fragment or compute passes wrote."""

from __future__ import annotations

import numpy as np

from ...gpu import textures
from ...gpu.kernel import Entry
from ...gpu.textures import Texture
from ..kernels.single_passes import copy_pass


class Reader:
    """Downloads textures. A fragment pass first copies the output of a compute dispatch, to order write and read."""

    def __init__(self, entry: Entry):
        self._copy = copy_pass() if entry == "compute" else None
        self._copies: dict[tuple[int, int], Texture] = {}

    def read(self, texture: Texture) -> np.ndarray:
        """Return a texture's contents as (H, W, C) float32."""
        if self._copy is None:
            return textures.download(texture)
        size = texture.width, texture.height
        if size not in self._copies:
            self._copies[size] = textures.empty(*size)
        target = self._copies[size]
        self._copy.run([target], {"u_source": texture})
        return textures.download(target)[..., : textures.CHANNELS[texture.format]]

    def close(self) -> None:
        """Free the pass and its copies."""
        if self._copy is not None:
            self._copy.close()
        self._copies.clear()
