"""Interprets any model's maps as a diffuse base with one or two specular lobes.

A parameter's meaning is the Blender socket that it drives, of a Principled BSDF or of the two-lobe group.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..blender.materials.two_lobe_nodes import settings_of
from ..core.errors import InputError
from ..reflectance.model import Parameter, ReflectanceModel
from ..results.maps import Maps

# Sockets that ``surface_of`` reads, by shader.
_SOCKETS = {
    "principled": ("Base Color", "Specular IOR Level", "Roughness", "Metallic"),
    "two_lobe": ("Base Color", "Weight", "Roughness 1", "Roughness 2"),
}
_IOR = 1.5  # Principled's default, with reflectance 0.04 at normal incidence
F0_HALF = 0.04  # reflectance at a Specular IOR Level of 0.5


@dataclass(frozen=True)
class Lobe:
    """One specular lobe of H×W texels. weight, alpha (width): (H, W). distribution: "GGX" or "BECKMANN"."""

    weight: np.ndarray
    alpha: np.ndarray
    distribution: str


@dataclass(frozen=True)
class Surface:
    """A material, (H, W, …) float32, row 0 at the bottom, margins not filled.

    base_color: (H, W, 3) linear. normal: (H, W, 3) unit, OpenGL. lobes: with weights of sum 1, or none. f0: (H, W) the
    dielectric's reflectance at normal incidence. metallic: (H, W), 0 if the model has none. layered: as in Principled,
    whose base receives only the light that the lobes do not reflect, and whose dielectric follows Fresnel's equations.
    """

    base_color: np.ndarray
    normal: np.ndarray
    lobes: tuple[Lobe, ...]
    f0: np.ndarray
    metallic: np.ndarray
    layered: bool

    @property
    def f90(self) -> np.ndarray:
        """(H, W) the dielectric's reflectance at grazing incidence in Schlick's approximation: near 0 as f0 is."""
        return _grazing(self.f0) if self.layered else np.ones_like(self.f0)

    def base_below(self, strength: np.ndarray) -> np.ndarray:
        """Return (H, W, 3) the base colour for a shader of layers, whose base lacks what its lobe reflects.

        strength: (H, W) that of a ``Fit`` as one lobe. A base beside its lobes is raised by the lobe's reflectance at
        normal incidence, up to 1: its radiance is the same from the front, and up to 4 % too dark from 60°.
        """
        if self.layered:
            return self.base_color
        return np.minimum(self.base_color / (1 - self.f0 * strength)[..., None], 1)

    @property
    def specular_color(self) -> np.ndarray:
        """(H, W, 3) the reflectance at normal incidence of the dielectric and the metal together."""
        metallic = self.metallic[..., None]
        return self.f0[..., None] * (1 - metallic) + self.base_color * metallic


def surface_of(maps: Maps) -> Surface:
    """Return the material of maps. Raises InputError if the model's shader is neither Principled nor two-lobe."""
    shader = maps.model.material.get("shader")
    if shader == "two_lobe":
        return _two_lobes(maps)
    if shader == "principled" and _named(maps.model, "Base Color") is not None:
        return _principled(maps)
    raise InputError(
        f'model {maps.model.name}: [material] has neither shader = "principled" nor "two_lobe", so the meaning of its'
        " maps is unknown; export it as textures or ptm"
    )


def _grazing(f0: np.ndarray) -> np.ndarray:
    """Return the F90, at most 1, with which Schlick's curve is nearest to Fresnel's of dielectrics.

    The relative difference is least in the mean square over angles up to 80°. f0: above 0.02 the result is 1.
    """
    cosine = np.cos(np.radians(np.linspace(0, 80, 81)))[:, None]
    table = np.geomspace(1e-5, 0.1, 64)
    index = (1 + np.sqrt(table)) / (1 - np.sqrt(table))
    g = np.sqrt(index**2 - 1 + cosine**2)  # Cook & Torrance 1982
    ratio = (cosine * (g + cosine) - 1) / (cosine * (g - cosine) + 1)
    exact = ((g - cosine) / (g + cosine)) ** 2 / 2 * (1 + ratio**2)
    rise = (1 - cosine) ** 5
    slope, rest = rise / exact, 1 - table * (1 - rise) / exact
    nearest = np.clip((slope * rest).sum(axis=0) / (slope**2).sum(axis=0), 0, 1)
    return np.interp(f0, np.append(0, table), np.append(0, nearest)).astype(np.float32)


def unused_parameters(model: ReflectanceModel) -> tuple[str, ...]:
    """Return the names of the parameters that ``surface_of`` leaves out: of a coat, a grain or other sockets."""
    sockets = _SOCKETS.get(str(model.material.get("shader")), ())
    used = [_named(model, socket) for socket in sockets]
    return tuple(p.name for p in model.parameters if sockets and not p.is_normal and p not in used)


def _principled(maps: Maps) -> Surface:
    shape = maps.solved.shape
    settings = dict(maps.model.material.get("settings", {}))
    settings.pop("distribution", None)
    ior = float(settings.get("IOR", _IOR))
    matte = not settings and _named(maps.model, "Roughness") is None
    level = _map(maps, "Specular IOR Level", 0.0 if matte else settings.get("Specular IOR Level", 0.5))
    f0 = 2 * level * ((ior - 1) / (ior + 1)) ** 2
    roughness = _map(maps, "Roughness", settings.get("Roughness", 0.5))
    lobe = Lobe(np.ones(shape, np.float32), np.maximum(roughness, 1e-3) ** 2, "GGX")
    metallic = _map(maps, "Metallic", settings.get("Metallic", 0.0))
    lobes = () if matte else (lobe,)
    return Surface(_color(maps), _normal(maps), lobes, f0.astype(np.float32), metallic, layered=True)


def _two_lobes(maps: Maps) -> Surface:
    shape, settings = maps.solved.shape, settings_of(maps.model)
    first = _map(maps, "Weight", 0.5)
    lobes = []
    for number, weight in ((1, first), (2, 1 - first)):
        alpha = _map(maps, f"Roughness {number}", 0.5)
        lobes.append(Lobe(weight, alpha**2 if settings.roughness == "perceptual" else alpha, settings.distribution))
    f0 = np.full(shape, settings.f0, np.float32)
    return Surface(_color(maps), _normal(maps), tuple(lobes), f0, np.zeros(shape, np.float32), layered=False)


def _named(model: ReflectanceModel, socket: str) -> Parameter | None:
    """Return the parameter that drives a socket; a parameter without a socket matches by its name."""
    by_name = socket.lower().replace(" ", "_")
    aliases = {"roughness_1": "r1", "roughness_2": "r2", "weight": "w"}
    for parameter in model.parameters:
        if parameter.socket == socket or (not parameter.socket and parameter.name == aliases.get(by_name, by_name)):
            return parameter
    return None


def _map(maps: Maps, socket: str, otherwise: float) -> np.ndarray:
    """Return (H, W) float32 of the parameter that drives a socket, or ``otherwise`` everywhere."""
    parameter = _named(maps.model, socket)
    if parameter is None:
        return np.full(maps.solved.shape, otherwise, np.float32)
    return _values(maps, parameter)[..., 0]


def _color(maps: Maps) -> np.ndarray:
    parameter = _named(maps.model, "Base Color")
    if parameter is None or parameter.components != 3:
        raise InputError(f"model {maps.model.name}: no parameter with three components drives Base Color")
    return _values(maps, parameter)


def _normal(maps: Maps) -> np.ndarray:
    parameter = next((p for p in maps.model.parameters if p.is_normal), None)
    if parameter is None:
        return np.broadcast_to(np.float32([0, 0, 1]), (*maps.solved.shape, 3))
    return _values(maps, parameter)


def _values(maps: Maps, parameter: Parameter) -> np.ndarray:
    """Return (H, W, components) float32, the default for a parameter without a map."""
    shape = (*maps.solved.shape, parameter.components)
    value = np.asarray(maps.values.get(parameter.name, parameter.default), np.float32)
    return value.reshape(shape) if value.size == np.prod(shape) else np.broadcast_to(value.reshape(-1), shape)
