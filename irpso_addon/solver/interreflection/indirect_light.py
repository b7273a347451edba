"""Indirect light of a recovered subject: light that its surfaces send to each other, by Monte Carlo radiosity."""

from __future__ import annotations

from collections.abc import Generator, Mapping
from functools import cached_property

import numpy as np

from ...core.filters import weighted_median
from ...geometry.domain import Domain
from ...geometry.light.light_shape import beam_shares
from ...geometry.light.light_transport import LightTransport
from ...geometry.nearest import nearest
from ...gpu import context, textures
from ...gpu.bands import Bands
from ...reflectance.model import ReflectanceModel
from ..kernels.single_passes import TRANSPORT_LIGHTS, light_transport_pass
from ..phases.phase import BAND_SECONDS
from ..state.prepare import light_vectors
from ..state.textures import observation_defines
from ..views.forward import render_inputs
from .corrected_stack import IndirectSamples

_MIN_ALBEDO = 0.02  # for the detail of albedo between elements, without the noise of black ones
_AWAY = -0.1  # cosine to a light below which a surface faces away, even if its normal is wrong by 5°
_MIN_SHARE = 0.01  # of the brightness of the photographs: less is no evidence
_MIN_SAMPLES = 100
_MAX_STRENGTH = 30.0
# Few rays hit lobes that are narrower than the angle between rays, and such lobes of elements miss each other. A wider
# lobe sends the same light. In a glazed mouth, of roughness 0.15, it lowers the normal error from 2.6 to 2.1°.
_MIN_ROUGHNESS = 0.3
_MAX_NOISE = 3.0  # factor between a dark sample and the median of all; beyond it a lamp reaches the sample
_BRANCHES = 4  # rays followed from the element that a ray hits, in the pass to the camera
_EXPONENTS = 100  # of powers of two in float32, with room for their products
_COLUMNS = 1024  # of the grid of elements; software renderers share out squares of 64 texels among their threads


class IndirectLight:
    """Estimates the indirect light that a subject's maps predict. Close it after use.

    domain: of the maps. transport: elements of the surface. bounces: between surfaces. values: the maps, parameter name
    → (H, W, components). known: (H, W) bool, where the maps determine the material; other elements get the material of
    the nearest known one, or of the nearest solvable one if none is known. Elements that are not solvable have the
    mesh's own normal. materials: of the E elements, parameter name → (E, components); the light is computed with wider
    lobes. covered: (H, W) bool, the texels of ``samples``. shadowed: as of InterreflectionSurface. Radiances of
    elements are as photographed.
    """

    def __init__(
        self,
        domain: Domain,
        transport: LightTransport,
        model: ReflectanceModel,
        values: Mapping[str, np.ndarray],
        known: np.ndarray,
        bounces: int,
        shadowed: bool = True,
    ):
        context.ensure()
        self._domain, self.transport, self._bounces, self._shadowed = domain, transport, bounces, shadowed
        self.covered = domain.bake.coverage
        count = len(transport.texels)
        columns = min(count, _COLUMNS)
        self._shape = -(-count // columns), columns
        self.materials = self._materials(model, values, known)
        least = _least_values(model)
        wide = {
            name: np.maximum(value, np.float32(least[name])) if name in least else value
            for name, value in self.materials.items()
        }
        albedo = next((p.name for p in model.parameters if p.is_albedo), None)
        self._detail: np.ndarray | None = None  # (T, 3) albedo of the covered texels
        if albedo is not None:
            self._albedo = wide[albedo]
            own = np.maximum(values[albedo][self.covered], _MIN_ALBEDO)
            self._detail = np.where(known[self.covered][:, None], own, transport.at_texels(self._albedo))
        self._normals = self.materials[model.normal]
        bake = domain.bake.map_arrays(lambda flat: self._grid(_flat(flat)[transport.texels]))
        materials = {name: self._grid(value) for name, value in wide.items()}
        self._groups = _of_one_view(domain.views)
        columns = np.concatenate([np.pad(group, (0, TRANSPORT_LIGHTS - len(group)), "edge") for group in self._groups])
        self._units = self._powers_of_two()
        lighting = domain.lights[columns], (domain.intensities / self._units[:, None])[columns], domain.views[columns]
        self._inputs = render_inputs(bake, model, materials, *lighting)
        self._inputs["u_rays"] = textures.upload_layers(np.stack([self._grid(ray) for ray in _hits_first(transport)]))
        self._unlit, *self._targets = (
            [textures.empty(*self._shape[::-1], value=0.0) for _ in range(TRANSPORT_LIGHTS)] for _ in range(3)
        )
        self._pass = light_transport_pass(model, observation_defines(domain.lights, domain.views, domain.card))
        places = self._places
        self._bands = Bands(paced=True)
        shares, divisors = zip(*(beam_shares(domain, k, places) for k in range(domain.observations)), strict=True)
        self._lit = transport.lit * np.float32(shares)  # (K, E) fraction of each light's axial intensity
        self._divisors = np.stack(divisors)

    def samples(self, radiance: np.ndarray) -> IndirectSamples:
        """Return the samples of the texels under radiances (K, E, 3) of the elements."""
        of_elements = radiance if self._detail is None else radiance / self._albedo
        beamed = None if self._domain.beams is None else self._domain
        return IndirectSamples(self.covered, self.transport, of_elements, self._detail, beamed)

    @cached_property
    def shown(self) -> np.ndarray:
        """(K, E): photographed radiance of the elements, mean of the channels; 0 without a photograph."""
        return self._domain.stack.texels(*self._places)[..., :3].mean(axis=-1) * self._divisors

    @cached_property
    def seen(self) -> np.ndarray:
        """(K, E) bool: whether the camera of an observation sees an element under at least one lamp."""
        views, camera = np.unique(self._domain.views, axis=0, return_inverse=True)
        camera = camera.ravel()  # numpy 2.0 returns another axis
        return np.stack([(self.shown[camera == number] > 0).any(axis=0) for number in range(len(views))])[camera]

    @property
    def _places(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the elements' texels."""
        rows, columns = np.divmod(self.transport.texels, self._domain.shape[1])
        return rows, columns

    def strength(self, radiance: np.ndarray) -> float:
        """Return the factor on radiances (K, E, 3) of the elements that agrees best with samples in shadow.

        Where no lamp reaches, a photograph shows indirect light alone: in cast shadows, where they are the photographs'
        own, and on surfaces that face away. Its scale is free, because direct light
        determines only the product of the lamps' intensities and the base colours. 1 without such samples.
        """
        domain, shown = self._domain, self.shown
        toward, _ = light_vectors(domain, self._places)
        cosine = (toward * self._normals).sum(axis=-1)
        predicted = radiance.mean(axis=-1)
        dark = (self._shadowed & (self._lit == 0)) | (cosine < _AWAY)
        enough = predicted > _MIN_SHARE * np.percentile(shown[self.seen], 90)
        counted = dark & self.seen & enough & domain.solvable[self._places]
        if np.count_nonzero(counted) < _MIN_SAMPLES:
            return 1.0
        # Medians, because a sample that a lamp reaches against expectation is far brighter. The second has both
        # radiances as weights: one alone would bias it to samples in which noise makes that one brighter.
        shown, predicted = shown[counted], predicted[counted]
        ratio = shown / predicted
        middle = weighted_median(ratio, predicted)
        if middle <= 0:
            return 0.0
        near = (ratio >= middle / _MAX_NOISE) & (ratio <= middle * _MAX_NOISE)
        return min(weighted_median(ratio[near], np.sqrt(shown[near] * predicted[near])), _MAX_STRENGTH)

    def of_elements(self) -> Generator[None, None, tuple[np.ndarray, np.ndarray]]:
        """Yield often; return (K, E, 3) float32: the indirect radiance of the elements in each observation.

        And (K, E): the direct radiance of the same materials, mean of the channels.
        """
        count = len(self.transport.texels)
        indirect, direct = np.empty((*self._lit.shape, 3), np.float32), np.empty(self._lit.shape, np.float32)
        for number, group in enumerate(self._groups):
            lit = np.zeros((count, TRANSPORT_LIGHTS), np.float32)
            lit[:, : len(group)] = self._lit[group].T
            inputs = {**self._inputs, "u_lit": textures.upload(self._grid(lit))}
            textures_of_group = yield from self._radiances(number, inputs)
            for observation, texture in zip(group, textures_of_group, strict=False):
                radiance = textures.download(texture).reshape(-1, 4)[:count]
                radiance *= self._units[observation]
                indirect[observation], direct[observation] = radiance[:, :3], radiance[:, 3]
        return indirect, direct

    def _powers_of_two(self) -> np.ndarray:
        """Return (K,) float32: the light of each observation at the middle one of the elements, as a power of two.

        The pass limits radiances for light of about 1. Powers of two leave the bits of what stays below the limit.
        """
        domain, places = self._domain, _flat(self._domain.bake.position)[self.transport.texels].astype(np.float64)
        light = domain.intensities.mean(axis=-1, dtype=np.float64)
        for k in np.flatnonzero(domain.lights[:, 3] > 0):
            light[k] /= np.median(((domain.lights[k, :3] - places) ** 2).sum(axis=-1))
        exponent = np.log2(light, out=np.zeros_like(light), where=light > 0)
        return np.exp2(np.round(np.clip(exponent, -_EXPONENTS, _EXPONENTS))).astype(np.float32)

    def _radiances(
        self, number: int, inputs: Mapping[str, textures.Texture]
    ) -> Generator[None, None, list[textures.Texture]]:
        """Yield often; return a texture for each observation of a group: indirect radiance, and direct in alpha."""
        received, (target, other) = self._unlit, self._targets
        constants = {
            "u_observation": number * TRANSPORT_LIGHTS, "u_ray_count": len(self.transport.hits),
            "u_columns": self._shape[1],
        }  # fmt: skip
        branches = _BRANCHES if self._bounces > 1 else 0  # with branches the last pass computes two bounces
        passes = self._bounces - bool(branches)
        for left in reversed(range(passes)):
            last = left == 0
            bounce = {"u_to_camera": int(last), "u_branches": branches if last else 0}
            before = {f"u_received_{i}": texture for i, texture in enumerate(received)}
            given = target, {**inputs, **before}, constants | bounce
            yield from self._pass.in_bands(f"transport {int(last)}", self._bands, BAND_SECONDS, *given)
            received, target, other = target, other, target
        return received

    def close(self) -> None:
        """Free shader and textures."""
        self._pass.close()
        self._inputs.clear()
        self._targets.clear()
        self._unlit.clear()

    def _grid(self, values: np.ndarray) -> np.ndarray:
        """Return (h, w, …): the grid of elements (E, …), with zeros at the end."""
        laid = np.zeros((self._shape[0] * self._shape[1], *values.shape[1:]), values.dtype)
        laid[: len(values)] = values
        return laid.reshape(*self._shape, *values.shape[1:])

    def _materials(
        self, model: ReflectanceModel, values: Mapping[str, np.ndarray], known: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Return parameter name → (E, components) of all elements: their own, or those of the nearest known element."""
        texels = self.transport.texels
        known_elements = _flat(known)[texels]
        if not known_elements.any():
            known_elements = _flat(self._domain.solvable)[texels]
        nearest = self._nearest(known_elements)
        materials = {}
        for p in model.parameters:
            materials[p.name] = _flat(values[p.name])[texels[nearest]]
            if p.is_normal:
                own = _flat(self._domain.solvable)[texels, None]
                materials[p.name] = np.where(own, _flat(values[p.name])[texels], np.array((0, 0, 1), np.float32))
        return materials

    def _nearest(self, known: np.ndarray) -> np.ndarray:
        """Return (E,): for each element the nearest known one; a known element is its own."""
        places = _flat(self._domain.bake.position)[self.transport.texels]
        result, others = np.arange(len(places)), np.flatnonzero(known)
        if len(others):
            result[~known] = others[nearest(places[~known], places[others])]
        return result


def _of_one_view(views: np.ndarray) -> list[np.ndarray]:
    """Return the numbers of observations with views (K, 4), at most TRANSPORT_LIGHTS together and of one view."""
    of_views, camera = np.unique(views, axis=0, return_inverse=True)
    cameras = [np.flatnonzero(camera.ravel() == number) for number in range(len(of_views))]
    return [own[at : at + TRANSPORT_LIGHTS] for own in cameras for at in range(0, len(own), TRANSPORT_LIGHTS)]


def _hits_first(transport: LightTransport) -> np.ndarray:
    """Return (R + 1, E, 4) float32: directions as long as their cosines, and elements, hits first; last the number."""
    hit = transport.hits >= 0
    order = np.argsort(~hit, axis=0, kind="stable")
    rays = np.zeros((len(order) + 1, len(transport.texels), 4), np.float32)
    long = transport.directions * transport.cosines[..., None]
    rays[:-1, :, :3] = np.take_along_axis(long, order[..., None], axis=0)
    rays[:-1, :, 3] = np.take_along_axis(transport.hits, order, axis=0)
    rays[-1, :, 0] = hit.sum(axis=0)
    return rays


def _flat(values: np.ndarray) -> np.ndarray:
    """Return (H·W, …) of (H, W, …)."""
    return values.reshape(-1, *values.shape[2:])


def _least_values(model: ReflectanceModel) -> dict[str, float]:
    """Return parameter name → least value with which light is computed."""
    roughness = _MIN_ROUGHNESS**2 if model.material.get("roughness") == "alpha" else _MIN_ROUGHNESS
    least = {p.name: roughness for p in model.parameters if "Roughness" in p.socket}
    return least | {p.name: _MIN_ALBEDO for p in model.parameters if p.is_albedo}
