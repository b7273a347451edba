"""IRPSO's lights and Blender's: an intensity of 1 is an irradiance of π at normal incidence."""

from __future__ import annotations

import math

# A Sun's strength is its irradiance (measured: strength 1 renders a white Lambertian at 1/π).
_SUN_STRENGTH_PER_INTENSITY = math.pi
# A point light spreads its power evenly over the sphere: E = P / (4π d²) at distance d.
_POINT_POWER_PER_INTENSITY = 4 * math.pi**2


def sun_strength(intensity: float) -> float:
    """Return the Strength of a Blender Sun whose irradiance at normal incidence is π·intensity."""
    return intensity * _SUN_STRENGTH_PER_INTENSITY


def sun_intensity(strength: float) -> float:
    """Return the intensity of a Blender Sun of this Strength."""
    return strength / _SUN_STRENGTH_PER_INTENSITY


def point_power(intensity: float) -> float:
    """Return the Power (W) of a Blender point light whose irradiance one world unit away is π·intensity.

    Cycles counts distance in world units, whatever unit they are shown in.
    """
    return intensity * _POINT_POWER_PER_INTENSITY


def point_intensity(power: float) -> float:
    """Return the intensity of a Blender point light of this Power (W)."""
    return power / _POINT_POWER_PER_INTENSITY
