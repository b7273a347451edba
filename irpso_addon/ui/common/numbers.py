"""Numbers that Blender stores in 32 bits, as the user typed them."""

from __future__ import annotations

import numpy as np


def typed(stored: float) -> float:
    """Return the shortest decimal that rounds to a property's value: 0.7 for 0.699999988, as on the command line."""
    return float(str(np.float32(stored)))
