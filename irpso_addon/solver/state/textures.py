"""Textures of a recovery: the domain and the estimates."""

from __future__ import annotations

from collections import ChainMap
from collections.abc import MutableMapping
from copy import copy

import numpy as np

from ...core.files import defined
from ...geometry.domain import Domain
from ...gpu import textures
from ...gpu.textures import Texture
from ...reflectance.model import ReflectanceModel
from .packing import Packing
from .separation_record import SEPARATED_SHADOW, Separation

UNFIT = defined("fitness/unfit.glsl")["UNFIT"]  # fitness of a material that was never evaluated
_STATES = defined("common/frame.glsl", "TEXEL_")
OUTSIDE, SOLVED, HALO = (_STATES[name] for name in ("OUTSIDE", "SOLVED", "HALO"))


class DomainTextures:
    """A domain on the GPU, its solved texels packed.

    stack: (K, h, w, 4), the packed samples and weights; None if ``give_stack`` uploads them later, which takes 0.1 s
    for 128 MiB. scale: (h, w) for a robust fitness. mean_irradiance: as in prepare.Prepared, by default the lights'
    mean intensity. arrays: from ``domain_arrays``, None to compute them. separation: (h, w), packed, of the
    indirect light that was subtracted from the samples (separation.py).
    """

    def __init__(
        self,
        domain: Domain,
        packing: Packing,
        stack: np.ndarray | None,
        scale: np.ndarray,
        mean_irradiance: float | None = None,
        arrays: dict[str, np.ndarray] | None = None,
        separation: Separation | None = None,
    ):
        self.domain, self.packing = domain, packing
        self.separation = Separation.none(scale.shape) if separation is None else separation
        self.mean_irradiance = float(domain.intensities.mean()) if mean_irradiance is None else mean_irradiance
        self.defines = kernel_defines(domain)
        self.scale, self.shadow = scale, np.zeros_like(scale)
        arrays = arrays or domain_arrays(domain, packing, scale)
        self.textures: MutableMapping[str, Texture] = {
            "u_geometry": textures.upload_layers(arrays["u_geometry"]), "u_packed": textures.upload(arrays["u_packed"])
        }  # fmt: skip
        self.textures["u_observation_table"] = upload_observations(domain.lights, domain.intensities, domain.views)
        if stack is not None:
            self.give_stack(stack)

    def raise_shadow(self, shadow: np.ndarray | float) -> None:
        """Set the part (h, w) of each texel's scale below which samples count as shadow; 0 changes no sample."""
        shadow = np.broadcast_to(np.float32(shadow), self.scale.shape)
        if not np.array_equal(shadow, self.shadow):
            self.shadow = shadow
            self.textures["u_geometry"] = textures.upload_layers(self._geometry())

    def where(self, chosen: np.ndarray) -> DomainTextures:
        """Return the same domain, in which only the chosen texels, (h, w) bool, are solved."""
        result = copy(self)
        geometry = self._geometry()
        geometry[0, ..., 3][~chosen] = OUTSIDE
        result.textures = ChainMap({"u_geometry": textures.upload_layers(geometry)}, self.textures)
        return result

    def _geometry(self) -> np.ndarray:
        """Return u_geometry. Texels whose threshold is raised further than by the separation do not count as separated.

        There the photographs have more indirect light than was subtracted.
        """
        geometry = domain_arrays(self.domain, self.packing, self.scale, self.shadow)["u_geometry"]
        separated = self.separation.separated & (self.shadow <= np.float32(SEPARATED_SHADOW))
        geometry[0, ..., 3] += np.where(separated, _STATES["SEPARATED"], 0)
        return geometry

    def give_stack(self, stack: np.ndarray) -> None:
        """Upload the packed sample stack (K, h, w, 4); shallow copies share it."""
        self.textures["u_stack"] = textures.upload_layers(stack)


def loss_constants(domain: DomainTextures, delta: float) -> dict[str, int | float]:
    """Return the push constants of a fitness over a domain; delta: δ as a fraction of a texel's scale."""
    return {
        "u_observations": domain.domain.observations, "u_delta": delta * domain.mean_irradiance,
        "u_mean_irradiance": domain.mean_irradiance,
    }  # fmt: skip


def domain_arrays(
    domain: Domain, packing: Packing, scale: np.ndarray, shadow: np.ndarray | None = None
) -> dict[str, np.ndarray]:
    """Return sampler name → array of a domain's geometry and packing, for the GPU. scale, shadow: (h, w)."""
    bake, seams = domain.bake, domain.seams
    normal = packing.pack(bake.normal, 0.0 if seams is None else seams.ghost_normal)
    tangent = packing.pack(bake.tangent, 0.0 if seams is None else seams.ghost_tangent)
    position, state = packing.pack(bake.position), packed_states(domain, packing)
    if shadow is not None:
        tangent = np.concatenate([tangent[..., :3], tangent[..., 3:] * (1 + shadow[..., None])], axis=-1)
    places, packed = packing.arrays()
    geometry = geometry_layers(position, normal, tangent, state, scale)
    return {"u_geometry": np.concatenate([geometry, places]), "u_packed": packed}


def geometry_layers(
    position: np.ndarray, normal: np.ndarray, tangent: np.ndarray, state: np.ndarray, scale: np.ndarray
) -> np.ndarray:
    """Return the layers of u_geometry that define the frames (shaders/common/frame.glsl), (3, H, W, 4) float32.

    state, scale: (H, W), carried in alpha.
    """
    layers = [(position, state[..., None]), (normal, scale[..., None]), (tangent,)]
    return np.stack([np.concatenate(parts, axis=-1, dtype=np.float32) for parts in layers])


def upload_observations(lights: np.ndarray, intensities: np.ndarray, views: np.ndarray) -> Texture:
    """Return the table of shaders/common/observation.glsl: K columns of light, intensity and view."""
    return textures.upload(np.stack([lights, np.pad(intensities, ((0, 0), (0, 1))), views]).astype(np.float32))


def kernel_defines(domain: Domain) -> dict[str, str | int]:
    """Return the defines of kernels over a domain: ``observation_defines``, and NOISE and SEAMS if it has them."""
    defines = observation_defines(domain.lights, domain.views, domain.card)
    if domain.noise:
        defines["NOISE"] = f"{domain.noise:.9f}"
    return defines if domain.seams is None else {**defines, "SEAMS": domain.seams.radius}


def observation_defines(lights: np.ndarray, views: np.ndarray, card: bool) -> dict[str, str | int]:
    """Return the defines that make a kernel cheaper: a card, only distant lights, one view for all observations."""
    defines: dict[str, str | int] = {"CARD": 1} if card else {}
    if not lights[:, 3].any():
        defines["DISTANT_LIGHTS"] = 1
    if (views == views[:1]).all():
        defines["ONE_VIEW"] = 1
    return defines


def texel_states(domain: Domain) -> np.ndarray:
    """Return (H, W) float32: 0 outside, 1 solved here, 2 solved by a neighbouring tile."""
    state = np.where(domain.solvable, SOLVED, OUTSIDE).astype(np.float32)
    left, right, bottom, top = domain.halo
    height, width = domain.shape
    inside = np.zeros(domain.shape, bool)
    inside[bottom : height - top, left : width - right] = True
    state[~inside & (state == SOLVED)] = HALO
    return state


def packed_states(domain: Domain, packing: Packing) -> np.ndarray:
    """Return (h, w) float32 states of packed texels: ghosts are solved by other tiles."""
    return packing.pack(texel_states(domain), HALO)


class Estimates:
    """The components of all parameters, packed in the table's order into one to three RGBA textures."""

    def __init__(self, model: ReflectanceModel, values: dict[str, np.ndarray]):
        self.model = model
        self.count = -(-model.components // 4)
        packed = np.concatenate([values[p.name] for p in model.parameters], axis=-1).astype(np.float32)
        packed = np.pad(packed, ((0, 0), (0, 0), (0, 4 * self.count - packed.shape[-1])))
        self.size = packed.shape[1], packed.shape[0]
        self.current = [textures.upload(packed[..., 4 * i : 4 * i + 4]) for i in range(self.count)]
        self.next = [textures.empty(*self.size) for _ in range(self.count)]
        self._shown: list[Texture] = []

    @property
    def shown(self) -> list[Texture]:
        """Textures for estimates that only a display shows; the recovery does not read them."""
        if not self._shown:
            self._shown = [textures.empty(*self.size) for _ in range(self.count)]
        return self._shown

    def bindings(self, of_next: bool = False) -> dict[str, Texture]:
        """Return the textures by sampler name: of the current estimates, or of the next ones."""
        chosen = self.next if of_next else self.current
        return {f"u_estimate_{i}": texture for i, texture in enumerate(chosen)}

    def swap(self) -> None:
        """Swap the next estimates with the current ones."""
        self.current, self.next = self.next, self.current

    def values(self, of_next: bool = True) -> dict[str, np.ndarray]:
        """Return the parameters as arrays (H, W, components)."""
        return self._split([textures.download(t) for t in (self.next if of_next else self.current)])

    def at(self, places: np.ndarray, of_next: bool) -> dict[str, np.ndarray]:
        """Return the parameters (n, components) at n places (x, y) of the textures."""
        return self._split([textures.texels(t, places) for t in (self.next if of_next else self.current)])

    def _split(self, read: list[np.ndarray]) -> dict[str, np.ndarray]:
        packed, at = np.concatenate(read, axis=-1), self.model.offset
        return {p.name: packed[..., at(p.name) : at(p.name) + p.components] for p in self.model.parameters}

    def close(self) -> None:
        """Free the textures."""
        self.current, self.next, self._shown = [], [], []
