"""Detection of ambiguous positions: photographs of a card that match it as well after a rotation or shift."""

from __future__ import annotations

from functools import cache

import numpy as np

from ...core.filters import blurred, sampled

_TURN = 15.0  # degrees between the rotations that are tried
_FINE = 0.02  # of the side: smaller details are noise and relief
_COARSE = 0.08  # of the side: larger ones are the flash's light
_NEAR = 0.06  # of the side: shifts that count as the same position
_MIN_OVERLAP = 0.35  # of the energy of each image's details: least part in the overlap
_MAX_DETAIL = 0.3  # bound of details, in the logarithm: the rim of paper on a table would outweigh the card
_RADIUS = 0.9  # of half the side: the compared circle; outside is the card's border, which is similar on four sides
_DOUBTFUL = 0.97  # similarity elsewhere over that in place: above, a position is ambiguous


def ambiguous_positions(pictures: np.ndarray) -> np.ndarray:
    """Return bool (K,): whether an image matches the others about as well in another position as in its own.

    pictures: (K, S, S) radiance on one square grid of the card, NaN where unknown. The similarity is the correlation,
    with the median of the other images, of details within a circle, over rotations and shifts.
    """
    details = np.stack([_details(picture) for picture in pictures])
    shares = np.array([_ambiguity(one, _median(np.delete(details, k, axis=0))) for k, one in enumerate(details)])
    return shares > _DOUBTFUL


def _details(picture: np.ndarray) -> np.ndarray:
    """Return the logarithm of an image, band-passed (S, S); NaN where unknown."""
    with np.errstate(divide="ignore", invalid="ignore"):
        value = np.log(picture)
    known = np.isfinite(value)
    side = len(picture)

    def mean(scale: float) -> np.ndarray:
        coverage = blurred(known.astype(float), scale * side)
        return blurred(np.where(known, value, 0.0), scale * side) / np.maximum(coverage, 1e-6)

    details = np.clip(mean(_FINE) - mean(_COARSE), -_MAX_DETAIL, _MAX_DETAIL)
    return np.where(known & _circle(side), details, np.nan)


def _circle(side: int) -> np.ndarray:
    offsets = (np.arange(side) + 0.5) / side * 2 - 1
    return np.hypot(*np.meshgrid(offsets, offsets)) < _RADIUS


def _median(details: np.ndarray) -> np.ndarray:
    """Return the median (S, S) of the images, 0 where fewer than half are known."""
    known = np.isfinite(details).mean(axis=0) >= 0.5
    return np.where(known, np.nanmedian(np.where(known, details, 0.0), axis=0), 0.0)


def _ambiguity(details: np.ndarray, target: np.ndarray) -> float:
    """Return the largest similarity in another position over that in place; infinity if the latter is not positive.

    The similarity is the normalised correlation over the overlap, for positions with enough energy of both in it.
    """
    side = len(target)
    size = (2 * side, 2 * side)  # no shift wraps around
    shift = 2 * np.fft.fftfreq(2 * side)  # in sides
    near = np.hypot(*np.meshgrid(shift, shift)) <= _NEAR
    circle = _circle(side)
    known, flat = np.isfinite(details).astype(float), np.nan_to_num(details)
    spectra = [np.conj(np.fft.rfft2(one, size)) for one in (target, (target != 0).astype(float), target**2)]
    own, other = 0.0, 0.0
    for turn, places in _turns(side):
        image, shown = (np.where(circle, sampled(one, places), 0.0) for one in (flat, known))
        products, energy, target_energy = (
            np.fft.irfft2(np.fft.rfft2(one, size) * spectrum, size)
            for one, spectrum in zip((image, image**2, shown), spectra, strict=True)
        )
        enough = (energy >= _MIN_OVERLAP * (image**2).sum()) & (target_energy >= _MIN_OVERLAP * (target**2).sum())
        similarity = np.where(enough, products / np.sqrt(np.maximum(energy * target_energy, 1e-12)), 0.0)
        if turn == 0:
            own = similarity[near].max()
            similarity[near] = 0.0
        other = max(other, similarity.max())
    return float(other / own) if own > 0 else np.inf


@cache
def _turns(side: int) -> tuple[tuple[float, np.ndarray], ...]:
    """Return rotations, in degrees, each with the pixel coordinates (S, S, 2) at which it samples an image."""
    centre = side / 2
    along = np.arange(side) + 0.5 - centre
    x, y = np.meshgrid(along, along)
    turns = []
    for degrees in np.arange(0, 360, _TURN):
        cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        turns.append((degrees, np.stack([cosine * x + sine * y, cosine * y - sine * x], axis=-1) + centre))
    return tuple(turns)
