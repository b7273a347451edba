"""Oracle of shaders/fitness/loss.glsl: the loss of a sample and its least-squares weight, in float64."""

import numpy as np

MIN_ERROR = 1e-4  # least l1 error in the weight 1 / |e|, as a part of white


def loss(kind, e):
    """Return the losses of errors: |e|, e², or, for errors in δ, log(1 + e²) or e² / (1 + e²)."""
    kinds = {"cauchy": lambda a: np.log1p(a**2), "geman_mcclure": lambda a: a**2 / (1 + a**2)}
    return ({"l1": np.abs, "l2": np.square} | kinds)[kind](e)


def loss_weight(kind, e, white=1.0):
    """Return loss′(e) / e, up to a constant factor. white: its radiance under the mean light."""
    if kind == "l1":
        return 1 / np.maximum(np.abs(e), MIN_ERROR * white)
    return np.ones_like(e) if kind == "l2" else 1 / (1 + e**2)
