"""Oracle of shaders/fitness/loss.glsl: the loss of a sample and its least-squares weight, in float64."""

import numpy as np

MIN_ERROR = 1e-4  # least l1 error in the weight 1 / |e|


def loss(kind, e):
    """Return the losses of errors: |e|, e², or, for errors in δ, log(1 + e²) or e² / (1 + e²)."""
    kinds = {"cauchy": lambda a: np.log1p(a**2), "geman_mcclure": lambda a: a**2 / (1 + a**2)}
    return ({"l1": np.abs, "l2": np.square} | kinds)[kind](e)


def loss_weight(kind, e):
    """Return loss′(e) / e, up to a constant factor."""
    kinds = {
        "l1": lambda a: 1 / np.maximum(np.abs(a), MIN_ERROR), "l2": np.ones_like, "cauchy": lambda a: 1 / (1 + a**2)
    }  # fmt: skip
    return kinds[kind](e)
