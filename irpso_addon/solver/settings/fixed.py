"""Fixed parameters: known maps that no search changes."""

from __future__ import annotations

import numpy as np

from ...core.errors import InputError
from ...reflectance.model import ReflectanceModel


def full_map(model: ReflectanceModel, name: str, value: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return a known value as a map (H, W, components) float32. value: (components,) or (H, W, components).

    Raises InputError where the shape does not match the model or the domain, or a number is not finite.
    """
    parameter = model.parameter(name)
    value = np.asarray(value, np.float32)
    if value.ndim == 1:
        value = np.broadcast_to(value, (*shape, len(value)))
    if value.shape != (*shape, parameter.components):
        raise InputError(
            f"fixed {name}: its shape is {value.shape}, the domain needs {(*shape, parameter.components)};"
            " resample it to the domain"
        )
    if not np.isfinite(value).all():
        raise InputError(f"fixed {name}: it holds values that are not finite; fill them first")
    return value
