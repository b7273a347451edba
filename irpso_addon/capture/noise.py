"""Estimates the noise of 8-bit photographs from the photographs themselves.

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

MIN_NOISE, MAX_NOISE = 1 / 255, 8 / 255  # of white; JPEG at its best; beyond eight codes the images are not aligned
# The noise is a constant of the kernels, which llvmpipe compiles in 50 s: few distinct values need few kernels.
STEP = 0.5 / 255
# For too few images: sensor, rounding and JPEG together. Under 16 lamps, of a rusty metal, normals are off by
# 1.76° without it, by 1.62, 1.45 and 1.35° with 1, 2 and 3 codes; its metallic by 0.050, 0.047, 0.040 and 0.036.
USUAL = 2 / 255
_IMAGES = 12  # most images to read
# Rank of a block's signal: three for a matt surface, one for a highlight, one for a shadow's edge. Noise-free
# renders of the benchmarks' cards differ from rank five by 0.1 to 0.3 codes, from rank four by 0.15 to 0.6.
_RANK = 5
_MIN_IMAGES = _RANK + 2  # images of a block
_SIDE, _BLOCKS, _MIN_BLOCKS = 8, 1000, 40  # pixels; most blocks; least usable blocks
_DARK = 8  # mean code: in darker blocks black clips the noise
_THRESHOLDS = linear_from_srgb(((np.arange(255) + 0.5) / 255).astype(np.float32))  # radiance between code k and k + 1


class NoiseEstimate:
    """Estimates a capture's noise from up to 12 of its images, passed to ``take`` or read by ``finishing``.

    The result does not depend on the order of the images.
    """

    def __init__(self, capture: Capture):
        self._size: tuple[int, ...] = ()
        self._chosen: list[Observation] = []
        self._corners = np.zeros((0, 2), int)
        self._blocks: dict[int, np.ndarray | None] = {}  # index in _chosen → codes, None where the size is wrong
        encoding = capture.encoding
        self._fine = not _coarse(capture) or (encoding is not None and encoding.colour_space != "srgb")
        if self._fine:
            return
        index, observations = _chosen(capture)
        corners = _corners(np.asarray(capture.masks[index], bool))
        if len(observations) >= _MIN_IMAGES and len(corners) >= _MIN_BLOCKS:
            self._size, self._chosen, self._corners = capture.masks[index].shape, observations, corners

    def take(self, observation: Observation, image: np.ndarray) -> None:
        """Add an observation's image (H, W, 4), as of ``Observation.read``; ignore observations that are not needed."""
        for place, one in enumerate(self._chosen):
            if one is observation:
                same_size = image.shape[:2] == self._size
                self._blocks[place] = _codes(np.asarray(image, np.float32), self._corners) if same_size else None

    def finishing(self) -> Generator[None, None, float]:
        """Yield before reading each image that is still missing; return the noise as ``noise_of`` does."""
        if self._fine:
            return 0.0
        for place, one in enumerate(self._chosen):
            if place not in self._blocks:
                yield
                with suppress(CaptureError):  # the recovery or inspect reports it
                    self.take(one, one.read())
        blocks = [block for _, block in sorted(self._blocks.items()) if block is not None]
        deviations = block_noise(np.stack(blocks, axis=1)) if blocks else np.zeros(0)
        if len(deviations) < _MIN_BLOCKS:
            return USUAL
        return float(np.clip(STEP * np.round(np.median(deviations) / (255 * STEP)), MIN_NOISE, MAX_NOISE))


def noise_of(capture: Capture) -> Generator[None, None, float]:
    """Return the noise's standard deviation in sRGB codes as a fraction of white; yield before each image is read.

    MIN_NOISE to MAX_NOISE in STEPs; USUAL if no camera has seven images or too few blocks are usable; 0 for files finer
    than 8-bit sRGB codes.
    """
    return NoiseEstimate(capture).finishing()


def images_read(capture: Capture) -> int:
    """Return the largest number of images that ``noise_of`` reads."""
    return min(_IMAGES, len(capture.observations)) if _coarse(capture) else 0


def block_noise(blocks: np.ndarray) -> np.ndarray:
    """Return (n,) standard deviations of the noise in blocks (B, K, N): N numbers of each of K images, NaN for none.

    n: the number of blocks that are complete in at least seven images.
    """
    complete = np.isfinite(blocks).all(axis=-1)
    usable = complete.sum(axis=-1) >= _MIN_IMAGES
    complete, blocks = complete[usable], blocks[usable]
    count, values = complete.sum(axis=-1), np.where(complete[..., None], blocks, 0)
    # An image that lacks the block adds an eigenvalue of 0.
    noise = np.linalg.eigvalsh(values @ values.transpose(0, 2, 1))[:, : blocks.shape[1] - _RANK].sum(axis=-1)
    return np.sqrt(np.maximum(noise, 0) / ((count - _RANK) * (blocks.shape[2] - _RANK)))


def _coarse(capture: Capture) -> bool:
    return all(one.coarse for one in capture.observations)


def _chosen(capture: Capture) -> tuple[int, list[Observation]]:
    """Return the index of the camera with the most images, and up to 12 of its observations."""
    counts = Counter(one.camera for one in capture.observations)
    index = min(counts, key=lambda camera: (-counts[camera], camera))
    # Sorted by name: held-out images may come last in the capture.
    own = sorted((one for one in capture.observations if one.camera == index), key=lambda one: one.name)
    places = np.unique(np.linspace(0, len(own) - 1, _IMAGES).round().astype(int))
    return index, [own[k] for k in places]


def _corners(mask: np.ndarray) -> np.ndarray:
    """Return (B, 2) first row and column of blocks that lie inside a mask (H, W)."""
    height, width = mask.shape
    inside = np.flatnonzero(mask[: max(height - _SIDE + 1, 0), : max(width - _SIDE + 1, 0)])
    if not len(inside):
        return np.zeros((0, 2), int)
    candidates = inside[np.random.default_rng(0).integers(len(inside), size=4 * _BLOCKS)]
    rows, columns = np.divmod(candidates, width - _SIDE + 1)
    complete = _blocks(mask, np.stack([rows, columns], axis=-1)).all(axis=(1, 2))
    return np.stack([rows, columns], axis=-1)[complete][:_BLOCKS]


def _blocks(image: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return the blocks (B, side, side, …) of an image (H, W, …)."""
    offsets = np.arange(_SIDE)
    return image[corners[:, 0, None, None] + offsets[:, None], corners[:, 1, None, None] + offsets]


def _codes(image: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return (B, N) sRGB codes 0…255 of blocks of an image; NaN for blocks that are clipped, not finite or dark."""
    blocks = _blocks(image, corners)
    codes = np.searchsorted(_THRESHOLDS, blocks[..., :3]).astype(np.float64).reshape(len(blocks), -1)
    usable = (blocks[..., 3] > 0).all(axis=(1, 2)) & (codes.mean(axis=-1) >= _DARK)
    return np.where(usable[:, None], codes, np.nan)
