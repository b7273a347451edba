"""Shipped reflectance models for numpy and PyTorch, and their parameters as numbers in a box.

``xp`` is the module ``numpy`` or ``torch``. Written from the papers that the shaders name; tested against the float64
oracles. T texels may also be T candidates of one texel: geometry whose texel axis is 1 broadcasts.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from irpso_addon.reflectance.model import load_model

from .problem import Problem, Values

Array = Any  # numpy's or torch's
F0_SKIN, F0_PER_LEVEL = 0.028, 0.08
_HORIZON = 1e-7  # least cosine of light and view above the horizon


@dataclass(frozen=True)
class Geometry:
    """Directions. lights: (K, 3). views: (3, T). half: (3, K, T) half vectors. between: (K, T) v·h."""

    lights: Array
    views: Array
    half: Array
    between: Array


def geometry_of(problem: Problem) -> Geometry:
    """Return the directions of a problem, float64 numpy."""
    total = problem.lights.T[:, :, None] + problem.views.T[:, None, :]
    length = np.maximum(np.linalg.norm(total, axis=0), 1e-12)
    return Geometry(problem.lights, np.ascontiguousarray(problem.views.T), total / length, length / 2)


def radiance(xp: ModuleType, model: str, values: dict[str, Array], g: Geometry) -> tuple[Array, Array]:
    """Return diffuse and specular factors (K, T) of parameters (T, components) under lights of intensity 1.

    The radiance is base_color · diffuse + specular. Raises KeyError for a model that is none of ``MODELS``.
    """
    normal = values["normal"]
    light = g.lights @ normal.T
    view = (g.views * normal.T).sum(0)
    seen = (light > _HORIZON) & (view > _HORIZON)
    one = xp.ones_like(light)
    light, view = xp.where(seen, light, one), xp.where(seen, view * one, one)
    # From the chord: 1 − (n·h)² has no precision near a highlight's peak in float32.
    chord = ((g.half - normal.T[:, None, :]) ** 2).sum(0)
    sin2 = xp.where(seen, chord * (1 - chord / 4), 0 * one)
    cos_h = xp.where(seen, 1 - chord / 2, one)
    diffuse, specular = MODELS[model](xp, {k: v[:, 0] for k, v in values.items()}, light, view, cos_h, sin2, g.between)
    return xp.where(seen, diffuse, 0 * one), xp.where(seen, specular, 0 * one)


def _lambert(xp, s, light, view, cos_h, sin2, between):
    return light, 0 * light


def _principled(xp, s, light, view, cos_h, sin2, between):
    """One GGX lobe (Walter et al. 2007 Eq. 33), Smith's G (Heitz 2014 Eq. 99), over a base times 1 − its albedo."""
    f0 = F0_PER_LEVEL * s["specular"]
    root = xp.sqrt(xp.clip(f0, 1e-12, None))  # the slope at 0 is infinite
    beyond = ((1 + root) / (1 - root)) ** 2 - 1
    a2 = s["roughness"] ** 4
    d = a2 / (np.pi * (sin2 + a2 * cos_h**2) ** 2)
    toward_light = view * xp.sqrt(light**2 + a2 * (1 - light**2))
    toward_view = light * xp.sqrt(view**2 + a2 * (1 - view**2))
    specular = np.pi * d * light * 0.5 / (toward_light + toward_view) * _dielectric(xp, between, beyond)
    return light * (1 - _layer_albedo(xp, view, s["roughness"], f0, beyond)), specular


def _cook_torrance_two_lobe(xp, s, light, view, cos_h, sin2, between):
    """Two Beckmann lobes (Cook & Torrance 1982 Eq. 7 and 9), Schlick's F, plus the full base."""
    d = s["w"] * _beckmann(xp, cos_h, sin2, s["r1"]) + (1 - s["w"]) * _beckmann(xp, cos_h, sin2, s["r2"])
    cavity = xp.minimum(xp.ones_like(light), 2 * cos_h * xp.minimum(light, view) / between)
    fresnel = F0_SKIN + (1 - F0_SKIN) * (1 - between) ** 5
    return light, 0.25 * np.pi * d * fresnel * cavity / view


MODELS = {"lambert": _lambert, "principled": _principled, "cook_torrance_two_lobe": _cook_torrance_two_lobe}


def _beckmann(xp, cos_h, sin2, slope):
    m2, cos2 = slope**2, cos_h**2
    return xp.exp(-sin2 / (cos2 * m2)) / (np.pi * m2 * cos2**2)


def _dielectric(xp, cosine, beyond):
    """Fresnel 1823, as Cook & Torrance 1982 Eq. 18; beyond: ior² − 1."""
    total = xp.sqrt(beyond + cosine**2) + cosine
    difference = beyond / total
    return 0.5 * (difference / total) ** 2 * (1 + ((cosine * total - 1) / (cosine * difference + 1)) ** 2)


def _layer_albedo(xp, m, r, f0, beyond):
    """The shader's fit to the albedo of the specular layer: shaders/brdf/e_specular.glsl."""
    above = m * (-0.4183 + m * (0.8193 - 8.231 * m)) + r * m * (5.514 + 3.45 * m) + r**2 * (1.336 - 4.016 * m)
    above = above - 0.8463 * r**3
    below = r + m * (3.508 + 3.157 * m) + r * (0.3903 * m + 0.7437 * r)
    squared = m**2 + r**2 * above / below * (f0 + 0.004179) / (f0 + 0.007262)
    return _dielectric(xp, xp.sqrt(xp.clip(squared, 1e-12, 1)), beyond)


class Box:
    """A model's parameters as numbers in [0, 1], for bounded methods.

    A normal is two numbers, its stereographic coordinates over −1…1 (smooth over the whole hemisphere); every other
    component is one, its position in its range.
    """

    def __init__(self, model: str):
        self.model = load_model(model)
        self.size = sum(2 if p.is_normal else p.components for p in self.model.parameters)

    def values(self, xp: ModuleType, x: Array) -> dict[str, Array]:
        """Return parameter → (T, components) of x (T, size)."""
        values, at = {}, 0
        for p in self.model.parameters:
            if p.is_normal:
                s, t = 2 * x[:, at] - 1, 2 * x[:, at + 1] - 1
                squared = s**2 + t**2
                values[p.name] = xp.stack([2 * s, 2 * t, 1 - squared], -1) / (1 + squared)[:, None]
                at += 2
            else:
                low, high = p.range
                values[p.name] = low + (high - low) * x[:, at : at + p.components]
                at += p.components
        return values

    def numbers(self, values: Values) -> np.ndarray:
        """Return (T, size) of parameter → (T, components), clipped to the box."""
        columns = []
        for p in self.model.parameters:
            value = np.asarray(values[p.name], np.float64)
            if p.is_normal:
                columns.append(0.5 + 0.5 * value[:, :2] / (1 + np.maximum(value[:, 2:], 0)))
            else:
                columns.append((value - p.range[0]) / (p.range[1] - p.range[0]))
        return np.clip(np.concatenate(columns, axis=1), 0, 1)

    def ordered(self, values: Values) -> Values:
        """Return the values with interchangeable lobes in the model's ascending order."""
        if not self.model.ordered:
            return values
        first, second = self.model.ordered
        swap = values[first] > values[second]
        out = dict(values)
        out[first], out[second] = (np.where(swap, values[b], values[a]) for a, b in ((first, second), (second, first)))
        for name in self.model.complement:
            out[name] = np.where(swap, 1 - values[name], values[name])
        return out
