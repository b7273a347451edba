"""Units of light: conversion between IRPSO's intensities (1: irradiance π at normal incidence) and Blender's."""

from __future__ import annotations

import math

# A Sun's strength is its irradiance (measured: strength 1 renders a white Lambertian at 1/π).
_SUN_STRENGTH_PER_INTENSITY = math.pi
# A point light spreads its power evenly over the sphere: E = P / (4π d²) at distance d.
_POINT_POWER_PER_INTENSITY = 4 * math.pi**2
# An area light is a Lambertian emitter: E = P cos θ / (π d²) at a distance d far above its size (measured in Cycles for
# square, oblong, round and oval lights of a fifteenth of the distance: within 0.4 %).
_AREA_POWER_PER_INTENSITY = math.pi**2


def sun_strength(intensity: float) -> float:
    """Return the Strength of a Blender Sun whose irradiance at normal incidence is π·intensity."""
    return intensity * _SUN_STRENGTH_PER_INTENSITY


def sun_intensity(strength: float) -> float:
    """Return the intensity of a Blender Sun of this Strength."""
    return strength / _SUN_STRENGTH_PER_INTENSITY


def point_power(intensity: float) -> float:
    """Return the Power (W) of a Blender point light whose irradiance one world unit away is π·intensity.

    Cycles measures distance in world units, not in display units.
    """
    return intensity * _POINT_POWER_PER_INTENSITY


def point_intensity(power: float) -> float:
    """Return the intensity of a Blender point light of this Power (W)."""
    return power / _POINT_POWER_PER_INTENSITY


# Inside its cone a spot is a point light of the same power (measured in Cycles for all cones: within 0.1 %).
spot_power, spot_intensity = point_power, point_intensity


def area_power(intensity: float) -> float:
    """Return the Power (W) of a Blender area light whose irradiance is π·intensity, one unit away along its axis.

    The far-field law is extrapolated to that distance: the light acts as a point at its centre.
    """
    return intensity * _AREA_POWER_PER_INTENSITY


def area_intensity(power: float) -> float:
    """Return the intensity along its axis of a Blender area light of this Power (W)."""
    return power / _AREA_POWER_PER_INTENSITY


def spot_cone(size: float, blend: float) -> float:
    """Return the half-angle, degrees, inside which a Blender spot has its full strength; 0 without such a part.

    size: of the full cone, radians; blend: 0…1. Cycles rises smoothly with the cosine to the axis, from 0 at the
    cone's border to full strength at this angle (measured: within a pixel's 0.6°).
    """
    border = math.cos(size / 2)
    return math.degrees(math.acos(min(border + blend * (1 - border), 1.0)))
