"""Fixed parameters: known maps that no search changes."""

from __future__ import annotations

import numpy as np

from ...core.errors import InputError
from ...reflectance.model import Parameter, ReflectanceModel

_ROUNDING = 1e-5  # of a unit vector's squared length in float32
_LENGTHS = (0.9, 1.1)  # of vectors that resampling has shortened; others are no normals
_OUTSIDE, _MANY = 0.01, 0.25  # of the range's width; part of the texels so far outside: more, and it is no such map


def full_map(model: ReflectanceModel, name: str, value: np.ndarray, solvable: np.ndarray) -> np.ndarray:
    """Return a known value as a map (H, W, components) float32. value: (components,) or (H, W, components).

    solvable: (H, W) bool; what the value is elsewhere does not count. Normals get the length 1, where they have not.
    Raises InputError where the shape does not match the model or the domain, a number is not finite, many lie outside
    the parameter's range, or normals are no unit vectors.
    """
    parameter, shape = model.parameter(name), solvable.shape
    value = np.asarray(value, np.float32)
    if value.ndim == 1:
        value = np.broadcast_to(value, (*shape, len(value)))
    if value.shape != (*shape, parameter.components):
        raise InputError(
            f"fixed {name}: its shape is {value.shape}, the domain needs {(*shape, parameter.components)};"
            " resample it to the domain"
        )
    _check_finite(f"fixed {name}", value)
    if parameter.is_normal:
        return _unit(name, value, solvable)
    return _inside(parameter, value, solvable)


def check_map(model: ReflectanceModel, name: str, values: np.ndarray, shown: np.ndarray, where: str) -> None:
    """Raise InputError, naming ``where``, if values (H, W, components) are no map of a parameter; see ``full_map``.

    shown: (H, W) bool, what counts; there normals may be 0, 0, 0. Numbers that no search finds, from 0 to a range's
    width above it, are materials too.
    """
    parameter, known = model.parameter(name), values[shown]
    _check_finite(where, known)
    if parameter.is_normal:
        length = np.linalg.norm(known.astype(np.float64), axis=-1)
        _check_lengths(where, length[length > 0])
        return
    low, high = parameter.range
    _check_range(where, parameter, known, 0.0 if low >= 0 else low - parameter.width, high + parameter.width)


def _check_finite(where: str, values: np.ndarray) -> None:
    if not np.isfinite(values).all():
        raise InputError(f"{where}: it holds values that are not finite; fill them first")


def _check_lengths(where: str, length: np.ndarray) -> None:
    if length.size and not _LENGTHS[0] <= np.median(length) <= _LENGTHS[1]:
        raise InputError(
            f"{where}: its vectors have the length {np.median(length):.3g}; give unit vectors with components from"
            " -1 to 1 (of a picture: twice its values, less 1)"
        )


def _check_range(where: str, parameter: Parameter, known: np.ndarray, low: float, high: float) -> None:
    outside = np.maximum(low - known, known - high) > _OUTSIDE * parameter.width
    if outside.size and outside.mean() > _MANY:
        raise InputError(
            f"{where}: its values reach from {known.min():.3g} to {known.max():.3g}; scale or clip them to between"
            f" {parameter.range[0]:g} and {parameter.range[1]:g}"
        )


def _unit(name: str, normals: np.ndarray, solvable: np.ndarray) -> np.ndarray:
    """Return normals (H, W, 3) of length 1; those that have it already keep their bits. Raises InputError."""
    squared = np.einsum("hwc,hwc->hw", normals, normals, dtype=np.float64)
    changed = np.abs(squared - 1) > _ROUNDING
    if not (changed & solvable).any():
        return normals
    length = np.sqrt(squared[solvable])
    if empty := np.count_nonzero(length == 0):
        raise InputError(f"fixed {name}: {empty} texels of the subject hold the vector 0, 0, 0; fill them first")
    _check_lengths(f"fixed {name}", length)
    scale = np.sqrt(np.where(changed & (squared > 0), squared, 1))[..., None]
    return (normals / scale).astype(np.float32)


def _inside(parameter: Parameter, values: np.ndarray, solvable: np.ndarray) -> np.ndarray:
    """Return values (H, W, n) put to the ends of the parameter's range. Raises InputError where many lie outside."""
    low, high = parameter.range
    _check_range(f"fixed {parameter.name}", parameter, values[solvable], low, high)
    return np.clip(values, np.float32(low), np.float32(high))
