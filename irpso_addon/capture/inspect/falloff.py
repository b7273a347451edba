"""Fall-off of radiance with the angle of incidence, as a test of the encoding of image files."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...core.encode import linear_from_srgb
from ..light_geometry import flatness
from .shading import bright_samples, shading_errors, with_factors

_EXPONENTS = np.geomspace(0.25, 4, 13)
_LOWEST = 0.4  # of a pixel's bright code values: darker samples are mostly shadow
_BRIGHT = 90.0  # percentile of a pixel's samples that counts as bright
_DARK = 0.06  # code value under which even a pixel's bright samples are mostly noise
_WIDTH = 0.03  # of the Cauchy weight, as a fraction of a pixel's bright samples
_ROUNDS = 3  # of reweighting
_GROUPS = 6  # of pixels, by angle of their normals
_MIN_LIGHTS, _MIN_PIXELS = 6, 60
_FLAT = 0.05  # flatness below which lights lie in one plane or direction
# Measured on rendered captures: linear values of matt and glossy dielectrics have an exponent of 0.96 to 1.22, and of
# 2.0 to 2.65 once they are decoded as sRGB. sRGB values of rough metals have 0.86 to 1.14, but then the exponent varies
# over the subject by a factor of 1.5 or more once decoded; that of dielectrics varies by less than 1.2. On a subject
# whose normals are alike nothing varies, so the test is inconclusive.
_MATT, _DECODED_TWICE, _NEVER_DECODED = (0.88, 1.22), (1.95, 2.7), (0.4, 0.51)
# Rendered spheres of dielectrics under 6 to 24 lamps, with noise and strengths that differ by up to 20 %: sRGB files
# whose lamps are as strong as a power of their height's cosine are below in 102 of 102 cases, linear files in 0 of 228.
_RIVAL = 1.4  # of the error as linear: at most that of sRGB files that explain the photographs as well
_SCALINGS = 4  # of the photographs' factors
_SPREAD, _MISFIT, _VARIETY = 1.2, 0.022, 20.0


@dataclass(frozen=True)
class FallOff:
    """exponent: k of radiance in proportion to (n·l)^k, one for all pixels (Minnaert 1941, for one view).

    spread: variation of the exponent over the subject: the second largest over the second smallest of six groups of
    pixels, grouped by angle from the mean normal or along one of the two principal axes of the normals, whichever gives
    the most. misfit: median error over a pixel's bright samples. variety: root mean square angle in degrees between the
    normals and their mean.
    """

    exponent: float
    spread: float
    misfit: float
    variety: float

    @property
    def matt(self) -> bool:
        """Whether radiance is clearly proportional to n·l."""
        return _within(self.exponent, _MATT) and self.misfit <= _MISFIT and self.variety >= _VARIETY


@dataclass(frozen=True)
class EncodingTest:
    """Fall-offs of code values taken as linear and as sRGB; None if undetermined.

    rival: the median error of matt shading as sRGB over that as linear, with a factor for each photograph, where the
    lights' intensities are not stated: lamps that are weaker the lower they stand add a cosine, as decoding does.
    """

    linear: FallOff | None
    srgb: FallOff | None
    rival: float = np.inf

    @property
    def sure(self) -> str:
        """The encoding, "linear" or "srgb", if the fall-off is conclusive; else ""."""
        if not self.likely or not self.linear or not self.srgb or max(self.linear.spread, self.srgb.spread) > _SPREAD:
            return ""
        found = self.linear if self.likely == "linear" else self.srgb
        return self.likely if found.matt and self.rival > _RIVAL else ""

    @property
    def likely(self) -> str:
        """The encoding that the exponents indicate, reliable or not; else ""."""
        if self.linear is None or self.srgb is None:
            return ""
        exponents = self.linear.exponent, self.srgb.exponent
        if _within(exponents[0], _MATT) and _within(exponents[1], _DECODED_TWICE):
            return "linear"
        return "srgb" if _within(exponents[1], _MATT) and _within(exponents[0], _NEVER_DECODED) else ""


def encoding_test(codes: np.ndarray, weight: np.ndarray, directions: np.ndarray, power: np.ndarray) -> EncodingTest:
    """Return the fall-offs of code values (K, T, 3), 0…1, of T pixels under K distant lights.

    weight: (K, T), 0 for ignored samples. directions: (K, 3) unit vectors toward the lights. power: (K,) their
    intensities. Values above 1 exclude sRGB.
    """
    codes = np.where(weight[..., None] > 0, codes, 0).astype(np.float64)
    dark = np.percentile(codes.mean(axis=-1), 80, axis=0) < _DARK
    codes = codes[:, ~dark]
    linear = codes.mean(axis=-1) / power[:, None]
    if codes.max(initial=0) > 1:
        return EncodingTest(fall_off(linear, directions, _LOWEST), None)
    srgb = linear_from_srgb(codes).mean(axis=-1) / power[:, None]
    test = EncodingTest(fall_off(linear, directions, _LOWEST), fall_off(srgb, directions, _LOWEST**2.2))
    unstated = np.ptp(power) == 0
    if test.sure != "linear" or not unstated:
        return test
    errors = [_error_with_factors(values, directions) for values in (srgb, linear)]
    return replace(test, rival=errors[0] / max(errors[1], 1e-9))


def _error_with_factors(values: np.ndarray, directions: np.ndarray) -> float:
    """Return the median error of matt shading with a factor for each photograph, over a pixel's bright sample."""
    samples = bright_samples(values, values > 0, directions[:, None])
    if samples is None:
        return np.inf
    relative, used, lamps = samples
    for _ in range(_SCALINGS):
        relative = with_factors(relative, used, lamps)
    return float(np.median(np.abs(shading_errors(relative, used, lamps)[0][used])))


def fall_off(samples: np.ndarray, directions: np.ndarray, lowest: float) -> FallOff | None:
    """Return the fall-off of radiances (K, T) of T pixels under distant lights (K, 3), None for too few.

    For each exponent k on a grid, iteratively reweighted least squares fits the pixels' scaled normals b to m^(1/k) of
    m = (b·l)^k, with low weights for highlights and shadow; the k of least loss is returned. lowest: samples under this
    fraction of a pixel's bright ones are ignored.
    """
    if len(directions) < _MIN_LIGHTS or samples.shape[1] < _MIN_PIXELS or flatness(directions) < _FLAT:
        return None
    bright = np.maximum(np.percentile(samples, _BRIGHT, axis=0), 1e-9)
    relative = samples / bright
    used = (samples > 0) & (relative > lowest)
    enough = used.sum(axis=0) >= _MIN_LIGHTS
    if enough.sum() < _MIN_PIXELS:
        return None
    relative, used = relative[:, enough], used[:, enough]
    fits = [_fit(relative, used, directions, k) for k in _EXPONENTS]
    losses = np.stack([np.log1p((error / _WIDTH) ** 2).sum(axis=0) for _, error in fits])
    scaled, error = fits[int(losses.sum(axis=1).argmin())]
    normals = scaled / np.maximum(np.linalg.norm(scaled, axis=1, keepdims=True), 1e-12)
    mean = normals.mean(axis=0)
    slant = np.degrees(np.arccos(np.clip(normals @ (mean / np.linalg.norm(mean)), -1, 1)))
    axes = np.linalg.svd(normals - mean, full_matrices=False)[2]
    spreads = [_spread_along(losses, key) for key in (slant, *(normals @ axes[:2].T).T)]
    return FallOff(
        _lowest_at(losses.sum(axis=1)), max(spreads), float(np.median(np.abs(error[used]))),
        float(np.sqrt((slant**2).mean())),
    )  # fmt: skip


def _spread_along(losses: np.ndarray, key: np.ndarray) -> float:
    """Return FallOff.spread for groups of pixels in the order of ``key``."""
    groups = np.array_split(np.argsort(key, kind="stable"), _GROUPS)
    exponents = sorted(_lowest_at(losses[:, group].sum(axis=1)) for group in groups)
    return exponents[-2] / exponents[1]


def _fit(relative: np.ndarray, used: np.ndarray, directions: np.ndarray, k: float) -> tuple[np.ndarray, np.ndarray]:
    """Return (T, 3) scaled normals and (K, T) errors of (b·l)^k, 0 where not used."""
    root = np.where(used, relative, 1) ** (1 / k)
    # d m = k m^(1−1/k) d m^(1/k): converts errors of the root to errors of the sample.
    slope = np.where(used, k * np.maximum(relative, 1e-3) ** (1 - 1 / k), 0) ** 2
    squares = (directions[:, :, None] * directions[:, None, :]).reshape(-1, 9)
    weight = slope
    for _ in range(_ROUNDS):
        gram = (weight.T @ squares).reshape(-1, 3, 3)
        gram += (1e-6 * np.trace(gram, axis1=1, axis2=2)[:, None, None] + 1e-12) * np.eye(3)
        scaled = np.linalg.solve(gram, ((weight * root).T @ directions)[..., None])[..., 0]
        error = np.where(used, np.maximum(directions @ scaled.T, 0) ** k - relative, 0)
        weight = slope / (1 + (error / _WIDTH) ** 2)
    return scaled, error


def _lowest_at(losses: np.ndarray) -> float:
    """Return the exponent of least loss over the grid, by a parabola through the three losses around it."""
    i = int(losses.argmin())
    if i in (0, len(losses) - 1):
        return float(_EXPONENTS[i])
    a, b, c = losses[i - 1 : i + 2]
    step = np.log(_EXPONENTS[1] / _EXPONENTS[0])
    return float(_EXPONENTS[i] * np.exp(0.5 * step * (a - c) / max(a - 2 * b + c, 1e-12)))


def _within(value: float, limits: tuple[float, float]) -> bool:
    return limits[0] <= value <= limits[1]
