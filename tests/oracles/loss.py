"""The loss of a sample in float64, and its least-squares weight: the reference of shaders/fitness/loss.glsl."""

import numpy as np

SMALLEST = 1e-4  # of an l1 error: under it no error weighs more


def loss(kind, e):
    """What errors cost: |e|, e², or, for errors in δ, log(1 + e²) or e² / (1 + e²)."""
    kinds = {"robust": lambda a: np.log1p(a**2), "geman_mcclure": lambda a: a**2 / (1 + a**2)}
    return ({"l1": np.abs, "l2": np.square} | kinds)[kind](e)


def loss_weight(kind, e):
    """loss′(e) / e, up to a constant factor."""
    kinds = {
        "l1": lambda a: 1 / np.maximum(np.abs(a), SMALLEST), "l2": np.ones_like, "robust": lambda a: 1 / (1 + a**2)
    }  # fmt: skip
    return kinds[kind](e)
