"""Detects whether image files that state no encoding hold linear or sRGB values."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Generator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from ...core.steps import run_steps
from ..errors import CaptureError
from ..inspect.falloff import EncodingTest, encoding_test
from .image import ImageRef, ImageStore, KnownBy

_IMAGES, _PIXELS, _CANDIDATES = 24, 400, 4000  # most in the test
_BACKGROUND = 0.2  # of the brightest pixel; without a mask most pixels may be darker
_WORDS = {"linear": "linear values", "srgb": "sRGB values"}


@dataclass(frozen=True)
class LitImage:
    """An image under a distant light. direction: (3,) unit, toward it. power: its mean intensity. camera: index."""

    image: ImageRef
    direction: tuple[float, float, float]
    power: float
    camera: int


@dataclass(eq=False)
class Encoding:
    """The encoding of one camera's images, as stated in their files or as measured from the fall-off of light.

    images: all with the same stated encoding, or all without. mask: (H, W) bool. store: reads them. assumed: "linear"
    or "srgb", the encoding before the test, which can change it only if ``known_by`` is "guess".
    """

    images: tuple[LitImage, ...]
    mask: np.ndarray
    store: ImageStore
    assumed: str
    known_by: KnownBy
    _test: EncodingTest | None = field(default=None, init=False)

    @property
    def test(self) -> EncodingTest:
        """Result of the test. The first access reads at most 24 images."""
        return run_steps(self.test_steps())

    @property
    def is_tested(self) -> bool:
        """Whether the test is done, so that ``message`` reads no image."""
        return self._test is not None

    def test_steps(self) -> Generator[None, None, EncodingTest]:
        """Return the result of the test; yield before each image is read."""
        if self._test is None:
            chosen = np.unique(np.linspace(0, len(self.images) - 1, _IMAGES).round().astype(int))
            lit = [self.images[k] for k in chosen]
            places = np.random.default_rng(0).permutation(np.flatnonzero(self.mask))[:_CANDIDATES]
            store, samples = ImageStore(self.store.decoder), []  # a second store: reading an EXR part removes it
            for one in lit:
                yield
                with suppress(CaptureError):  # the recovery or inspect reports it
                    codes = store.codes_at(replace(one.image, colour_space="linear"), places, self.mask.shape)
                    if codes is not None:
                        samples.append((one, codes))
            self._test = _test(samples)
        return self._test

    def resolve_steps(self) -> Generator[None, None, None]:
        """Run the test if the files state no encoding; yield before each image is read."""
        if self.known_by == "guess":
            yield from self.test_steps()

    @property
    def colour_space(self) -> str:
        """The encoding in use, "linear" or "srgb"."""
        return (self.test.sure if self.known_by == "guess" else "") or self.assumed

    def message(self) -> str:
        """Return a warning about the encoding, "" for none."""
        likely, linear, srgb = self.test.likely, self.test.linear, self.test.srgb
        if not likely or likely == self.assumed or not linear or not srgb:
            return ""
        first = f"{self.images[0].image}: this and the other images"
        exponents = (
            f"radiance goes with the power {linear.exponent:.2f} of the cosine if they are linear,"
            f" {srgb.exponent:.2f} if they are sRGB, and 0.8 to 1.3 on matt surfaces"
        )
        if self.colour_space == likely:
            return (
                f"{first} do not state their encoding and are read as {_WORDS[likely]}: {exponents}; if that is wrong,"
                f" set --colour-space {self.assumed} (Color Space)"
            )
        return (
            f"{first} are read as {_WORDS[self.assumed]} and {'' if self.test.sure else 'may '}hold {_WORDS[likely]}:"
            f" {exponents}; if so, set --colour-space {likely} (Color Space)"
        )


def encoding_of(images: Sequence[LitImage], masks: Sequence[np.ndarray], store: ImageStore) -> Encoding | None:
    """Return the encoding of the largest group of images of one camera and one stated encoding, None without images."""
    groups = defaultdict(list)
    for one in images:
        groups[one.camera, *store.encoding(one.image)].append(one)
    if not groups:
        return None
    (camera, assumed, known_by), group = max(groups.items(), key=lambda item: len(item[1]))
    return Encoding(tuple(group), masks[camera], store, assumed, known_by)


def _test(samples: Sequence[tuple[LitImage, np.ndarray]]) -> EncodingTest:
    """Return the test of the subject's bright pixels. samples: each image and its (T, 4) code values and weights."""
    if not samples:
        return EncodingTest(None, None)
    stack = np.stack([rgba for _, rgba in samples])
    bright = np.percentile(stack[..., :3].mean(axis=-1), 80, axis=0)
    used = np.flatnonzero(bright >= _BACKGROUND * bright.max(initial=0))[:_PIXELS]
    directions = np.array([one.direction for one, _ in samples], np.float64)
    power = np.array([one.power for one, _ in samples])
    return encoding_test(stack[:, used, :3], stack[:, used, 3], directions, power)
