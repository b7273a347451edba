"""Whether photographs of a card fit it as well when they are turned or moved: features do not tell such positions."""

from __future__ import annotations

from functools import cache

import numpy as np

from ...core.filters import blurred, sampled

_TURN = 15.0  # degrees between the turns that are tried
_FINE = 0.02  # of the side: what is smaller is noise and relief
_COARSE = 0.08  # of the side: what is larger is the flash's light
_NEAR = 0.06  # of the side: shifts that count as the same position
_SHARED = 0.35  # of the square sum of the details of each picture that must lie in what both show
_MOST = 0.3  # of the logarithm: the rim of paper on a table would outweigh the card
_ROUND = 0.9  # of the half side: what is compared; the rest shows the card's border, which is alike on four sides
_SURE = 0.97  # likeness elsewhere over that in place, above which a position is in doubt


def doubtful(pictures: np.ndarray) -> np.ndarray:
    """Return (K,) bool, true where a picture is about as like the others in another position as in its own.

    pictures: (K, S, S) radiance on one square grid of the card, NaN where unknown. Likeness is the correlation with the
    median of the other pictures, of details within a circle, over turns and shifts.
    """
    details = np.stack([_details(picture) for picture in pictures])
    shares = np.array([_elsewhere(one, _median(np.delete(details, k, axis=0))) for k, one in enumerate(details)])
    return shares > _SURE


def _details(picture: np.ndarray) -> np.ndarray:
    """Return (S, S) the logarithm of a picture between two scales, NaN where it is unknown."""
    with np.errstate(divide="ignore", invalid="ignore"):
        value = np.log(picture)
    known = np.isfinite(value)
    side = len(picture)

    def mean(scale: float) -> np.ndarray:
        share = blurred(known.astype(float), scale * side)
        return blurred(np.where(known, value, 0.0), scale * side) / np.maximum(share, 1e-6)

    found = np.clip(mean(_FINE) - mean(_COARSE), -_MOST, _MOST)
    return np.where(known & _circle(side), found, np.nan)


def _circle(side: int) -> np.ndarray:
    away = (np.arange(side) + 0.5) / side * 2 - 1
    return np.hypot(*np.meshgrid(away, away)) < _ROUND


def _median(details: np.ndarray) -> np.ndarray:
    """Return (S, S) the median of the pictures that show a place, 0 where fewer than half do."""
    shown = np.isfinite(details).mean(axis=0) >= 0.5
    return np.where(shown, np.nanmedian(np.where(shown, details, 0.0), axis=0), 0.0)


def _elsewhere(details: np.ndarray, wanted: np.ndarray) -> float:
    """Return the largest likeness in another position over that in the picture's own; infinite where it has none.

    Likeness is the normalised correlation of what both show, in positions in which that is enough of each of them.
    """
    side = len(wanted)
    size = (2 * side, 2 * side)  # no shift wraps around
    shift = 2 * np.fft.fftfreq(2 * side)  # in sides
    near = np.hypot(*np.meshgrid(shift, shift)) <= _NEAR
    circle = _circle(side)
    known, flat = np.isfinite(details).astype(float), np.nan_to_num(details)
    spectra = [np.conj(np.fft.rfft2(one, size)) for one in (wanted, (wanted != 0).astype(float), wanted**2)]
    own, other = 0.0, 0.0
    for turn, places in _turns(side):
        image, shown = (np.where(circle, sampled(one, places), 0.0) for one in (flat, known))
        both, energy, wanted_energy = (
            np.fft.irfft2(np.fft.rfft2(one, size) * spectrum, size)
            for one, spectrum in zip((image, image**2, shown), spectra, strict=True)
        )
        enough = (energy >= _SHARED * (image**2).sum()) & (wanted_energy >= _SHARED * (wanted**2).sum())
        found = np.where(enough, both / np.sqrt(np.maximum(energy * wanted_energy, 1e-12)), 0.0)
        if turn == 0:
            own = found[near].max()
            found[near] = 0.0
        other = max(other, found.max())
    return float(other / own) if own > 0 else np.inf


@cache
def _turns(side: int) -> tuple[tuple[float, np.ndarray], ...]:
    """Return the turns in degrees, and (S, S, 2) the places of a picture that each brings to its pixels."""
    middle = side / 2
    along = np.arange(side) + 0.5 - middle
    x, y = np.meshgrid(along, along)
    turns = []
    for degrees in np.arange(0, 360, _TURN):
        cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        turns.append((degrees, np.stack([cosine * x + sine * y, cosine * y - sine * x], axis=-1) + middle))
    return tuple(turns)
