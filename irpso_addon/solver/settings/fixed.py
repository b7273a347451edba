"""Parameters that are given and not searched."""

from __future__ import annotations

import numpy as np

from ...core.errors import InputError
from ...reflectance.model import ReflectanceModel


def full_map(model: ReflectanceModel, name: str, value: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return (H, W, components) float32 of a known value, (components,) or as large as the domain.

    Raises InputError where it does not fit the model or the domain.
    """
    parameter = model.parameter(name)
    value = np.asarray(value, np.float32)
    if value.ndim == 1:
        value = np.broadcast_to(value, (*shape, len(value)))
    if value.shape != (*shape, parameter.components):
        raise InputError(
            f"fixed {name}: its shape is {value.shape}, the domain wants {(*shape, parameter.components)};"
            " resample it to the domain"
        )
    if not np.isfinite(value).all():
        raise InputError(f"fixed {name}: it holds values that are not finite; fill them first")
    return value
