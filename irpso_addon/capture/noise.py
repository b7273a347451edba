"""The noise of 8-bit photographs, estimated from the photographs themselves.

The images of one camera show the same surface under several lights. In a small block of pixels they are nearly mixtures
of a few common pictures: three on a matt surface (Shashua 1997, On Photometric Issues in 3D Visual Recognition from a
Single 2D Image), whatever its texture. The smallest eigenvalues of a block's covariance are then the noise's (Pyatykh,
Hesser & Zheng 2013, Image Noise Level Estimation by Principal Component Analysis). Unlike the differences of
neighbouring pixels, they contain the noise that JPEG has left at all frequencies: where sensor and JPEG make 1.6 to 2.6
codes on rendered cards, diagonal differences give 0.7 to 1.6 and eigenvalues 1.1 to 2.8.

Glints of single pixels count as noise: a glossy relief whose normals differ by 6° from pixel to pixel adds 0.6 to 1
code, by 17° 2 to 3. Texture that JPEG removes equally from all images is not detected.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator
from contextlib import suppress

import numpy as np

from ..core.encode import linear_from_srgb
from .errors import CaptureError
from .types import Capture, Observation

LEAST, MOST = 1 / 255, 8 / 255  # of white; one code is JPEG at its best, beyond eight the images are not aligned
# Kernels are compiled with the noise, which takes llvmpipe 50 s of a processor; few values are compiled once for all.
STEP = 0.5 / 255
# Where the images are too few: sensor, rounding and JPEG together. Under 16 lamps, of a rusty metal, normals are off by
# 1.76° without it, by 1.62, 1.45 and 1.35° with 1, 2 and 3 codes; its metallic by 0.050, 0.047, 0.040 and 0.036.
USUAL = 2 / 255
_IMAGES = 12  # most images to read
# Common pictures of a block: three of a matt surface, one for a highlight, one for a shadow's edge. Renders of the
# benchmarks' cards, without noise, are off from five by 0.1 to 0.3 codes, from four by 0.15 to 0.6.
_COMMON = 5
_FEWEST = _COMMON + 2  # images of a block
_SIDE, _BLOCKS, _FEWEST_BLOCKS = 8, 1000, 40  # pixels; most blocks; least usable blocks
_DARK = 8  # mean code of a block under which black cuts the noise off
_BETWEEN = linear_from_srgb(((np.arange(255) + 0.5) / 255).astype(np.float32))  # radiance between code k and k + 1


class NoiseEstimate:
    """The noise of a capture's photographs, from some of them, as they are read anyway.

    It depends on the images only, not on the order in which they come.
    """

    def __init__(self, capture: Capture):
        self._size: tuple[int, ...] = ()
        self._chosen: list[Observation] = []
        self._corners = np.zeros((0, 2), int)
        self._blocks: dict[int, np.ndarray | None] = {}  # place among the chosen → codes, None where the size is wrong
        encoding = capture.encoding
        self._fine = not _coarse(capture) or (encoding is not None and encoding.colour_space != "srgb")
        if self._fine:
            return
        index, observations = _chosen(capture)
        corners = _corners(np.asarray(capture.masks[index], bool))
        if len(observations) >= _FEWEST and len(corners) >= _FEWEST_BLOCKS:
            self._size, self._chosen, self._corners = capture.masks[index].shape, observations, corners

    def take(self, observation: Observation, image: np.ndarray) -> None:
        """Take an observation's image (H, W, 4), as ``Observation.read`` gives it, if it is one of the chosen."""
        for place, one in enumerate(self._chosen):
            if one is observation:
                right = image.shape[:2] == self._size
                self._blocks[place] = _codes(np.asarray(image, np.float32), self._corners) if right else None

    def finishing(self) -> Generator[None, None, float]:
        """Yield before each chosen image that was not taken is read; return the deviation of ``noise_of``."""
        if self._fine:
            return 0.0
        for place, one in enumerate(self._chosen):
            if place not in self._blocks:
                yield
                with suppress(CaptureError):  # the recovery or inspect reports it
                    self.take(one, one.read())
        blocks = [block for _, block in sorted(self._blocks.items()) if block is not None]
        deviations = block_noise(np.stack(blocks, axis=1)) if blocks else np.zeros(0)
        if len(deviations) < _FEWEST_BLOCKS:
            return USUAL
        return float(np.clip(STEP * np.round(np.median(deviations) / (255 * STEP)), LEAST, MOST))


def noise_of(capture: Capture) -> Generator[None, None, float]:
    """Yield before each image is read, and return the standard deviation of the sRGB codes as a fraction of white.

    LEAST to MOST in STEPs; USUAL if no camera has seven images or too few blocks are usable; 0 for files finer than
    8-bit sRGB codes.
    """
    return NoiseEstimate(capture).finishing()


def images_read(capture: Capture) -> int:
    """Return how many images ``noise_of`` reads at the most."""
    return min(_IMAGES, len(capture.observations)) if _coarse(capture) else 0


def block_noise(blocks: np.ndarray) -> np.ndarray:
    """Return (n,) standard deviations of the noise in blocks (B, K, N): N numbers of each of K images, NaN for none.

    n: the number of blocks that enough images show completely.
    """
    shown = np.isfinite(blocks).all(axis=-1)
    usable = shown.sum(axis=-1) >= _FEWEST
    shown, blocks = shown[usable], blocks[usable]
    count, values = shown.sum(axis=-1), np.where(shown[..., None], blocks, 0)
    # An image that is left out adds an eigenvalue of 0.
    noise = np.linalg.eigvalsh(values @ values.transpose(0, 2, 1))[:, : blocks.shape[1] - _COMMON].sum(axis=-1)
    return np.sqrt(np.maximum(noise, 0) / ((count - _COMMON) * (blocks.shape[2] - _COMMON)))


def _coarse(capture: Capture) -> bool:
    return all(one.coarse for one in capture.observations)


def _chosen(capture: Capture) -> tuple[int, list[Observation]]:
    """Return the camera with the most images, by index, and some of them."""
    counts = Counter(one.camera for one in capture.observations)
    index = min(counts, key=lambda camera: (-counts[camera], camera))
    # By name, because held-out images may come last.
    own = sorted((one for one in capture.observations if one.camera == index), key=lambda one: one.name)
    places = np.unique(np.linspace(0, len(own) - 1, _IMAGES).round().astype(int))
    return index, [own[k] for k in places]


def _corners(mask: np.ndarray) -> np.ndarray:
    """Return (B, 2) rows and columns of the first pixels of blocks that lie inside a mask (H, W)."""
    height, width = mask.shape
    inside = np.flatnonzero(mask[: max(height - _SIDE + 1, 0), : max(width - _SIDE + 1, 0)])
    if not len(inside):
        return np.zeros((0, 2), int)
    drawn = inside[np.random.default_rng(0).integers(len(inside), size=4 * _BLOCKS)]
    rows, columns = np.divmod(drawn, width - _SIDE + 1)
    whole = _blocks(mask, np.stack([rows, columns], axis=-1)).all(axis=(1, 2))
    return np.stack([rows, columns], axis=-1)[whole][:_BLOCKS]


def _blocks(image: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return (B, side, side, …) of an image (H, W, …)."""
    along = np.arange(_SIDE)
    return image[corners[:, 0, None, None] + along[:, None], corners[:, 1, None, None] + along]


def _codes(image: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return (B, N) sRGB codes 0…255 of blocks of an image; NaN for blocks that are clipped, not finite or dark."""
    blocks = _blocks(image, corners)
    codes = np.searchsorted(_BETWEEN, blocks[..., :3]).astype(np.float64).reshape(len(blocks), -1)
    usable = (blocks[..., 3] > 0).all(axis=(1, 2)) & (codes.mean(axis=-1) >= _DARK)
    return np.where(usable[:, None], codes, np.nan)
