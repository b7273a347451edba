"""The light that a recovered subject throws on itself."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property

import numpy as np

from ...core.filters import weighted_median
from ...geometry.domain import Domain
from ...geometry.light.exchange import Exchange
from ...gpu import context, textures
from ...reflectance.model import ReflectanceModel
from ..kernels.kernels import exchange_pass
from ..state.prepare import light_vectors
from ..state.textures import observation_defines
from .forward import render_inputs

_CHUNK = 1 << 22  # distances at a time, of elements from each other
_LEAST_ALBEDO = 0.02  # brings out the detail of albedo between elements, without the noise of black ones
_AWAY = -0.1  # cosine to a light from which on a normal that is off by 5° still faces away
_LEAST_SHARE = 0.01  # of the brightness of the photographs: less tells nothing
_LEAST_SAMPLES = 100
_MOST_STRENGTH = 30.0
# Lobes narrower than the rays stand apart are met by few of them, and those of elements miss one another: a wider one
# sends as much. In a glazed mouth, of roughness 0.15, normals are off by 2.1 in place of 2.6°.
_LEAST_ROUGHNESS = 0.3
_MOST_NOISE = 3.0  # factor by which a dark sample differs from the median of all, unless a lamp reaches it
_BRANCHES = 8  # rays of an element on the way to the camera that a ray meets


class IndirectLight:
    """Finds what a subject's maps make it throw on itself. Close it after use.

    domain: of the maps. exchange: its elements. bounces: between surfaces. The maps are values: parameter name →
    (H, W, components). known: (H, W) bool, where they tell the material; elsewhere elements have that of the nearest
    one where they do. Elements that are not solvable have the mesh's own normal. materials: those of the E elements,
    parameter name → (E, components); the light is found from wider lobes. covered: (H, W) bool, the texels of
    ``at_texels``.
    """

    def __init__(
        self,
        domain: Domain,
        exchange: Exchange,
        model: ReflectanceModel,
        values: Mapping[str, np.ndarray],
        known: np.ndarray,
        bounces: int,
    ):
        context.ensure()
        self._domain, self.exchange, self._bounces = domain, exchange, bounces
        self.covered = domain.bake.coverage
        count = len(exchange.texels)
        columns = math.isqrt(count - 1) + 1
        self._shape = -(-count // columns), columns
        self.materials = self._materials(model, values, known)
        least = _least(model)
        lighting = {
            name: np.maximum(value, np.float32(least[name])) if name in least else value
            for name, value in self.materials.items()
        }
        albedo = next((p.name for p in model.parameters if p.is_albedo), None)
        self._detail: np.ndarray | None = None  # (T, 3) albedo of the covered texels
        if albedo is not None:
            self._albedo = lighting[albedo]
            own = np.maximum(values[albedo][self.covered], _LEAST_ALBEDO)
            self._detail = np.where(known[self.covered][:, None], own, exchange.at_texels(self._albedo))
        self._normals = next(self.materials[p.name] for p in model.parameters if p.is_normal)
        bake = domain.bake.each(lambda flat: self._laid(_flat(flat)[exchange.texels]))
        materials = {name: self._laid(value) for name, value in lighting.items()}
        self._inputs = render_inputs(bake, model, materials, domain.lights, domain.intensities, domain.views)
        rays = np.concatenate([exchange.directions, exchange.hits[..., None]], axis=-1, dtype=np.float32)
        self._inputs["u_rays"] = textures.upload_layers(np.stack([self._laid(ray) for ray in rays]))
        self._pass = exchange_pass(model, observation_defines(domain.lights, domain.views, domain.card))

    def at_texels(self, radiance: np.ndarray) -> np.ndarray:
        """Return (T, 3) float32 at the covered texels, row by row, of the radiance of elements (E, 3)."""
        if self._detail is None:
            return self.exchange.at_texels(radiance)
        return self.exchange.at_texels(radiance / self._albedo) * self._detail

    @cached_property
    def shown(self) -> np.ndarray:
        """(K, E) what the photographs show of the elements, mean of the channels; 0 where nothing was photographed."""
        return self._domain.stack.texels(*self._places)[..., :3].mean(axis=-1)

    @cached_property
    def seen(self) -> np.ndarray:
        """(K, E) bool, whether the camera of an observation sees an element, by any lamp."""
        views, camera = np.unique(self._domain.views, axis=0, return_inverse=True)
        camera = camera.ravel()  # numpy 2.0 gives it another axis
        return np.stack([(self.shown[camera == number] > 0).any(axis=0) for number in range(len(views))])[camera]

    @property
    def _places(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the elements' texels."""
        rows, columns = np.divmod(self.exchange.texels, self._domain.shape[1])
        return rows, columns

    def strength(self, radiance: np.ndarray) -> float:
        """Return by how much to multiply radiances (K, E, 3) of the elements, to agree with what shadows show.

        Where no lamp reaches, a photograph shows this light alone. It has a free factor: that of the lamps' intensities
        and of the base colours, which the direct light cannot tell apart. 1 where there are no such samples.
        """
        domain, shown = self._domain, self.shown
        toward, _ = light_vectors(domain, self._places)
        cosine = (toward * self._normals).sum(axis=-1)
        mine = radiance.mean(axis=-1)
        dark = ~self.exchange.lit | (cosine < _AWAY)
        enough = mine > _LEAST_SHARE * np.percentile(shown[self.seen], 90)
        counted = dark & self.seen & enough & domain.solvable[self._places]
        if np.count_nonzero(counted) < _LEAST_SAMPLES:
            return 1.0
        # Medians: a lamp that reaches where it seemed not to is far brighter. Weights of both in the second: those of
        # one alone draw it to where noise makes that one brighter.
        shown, mine = shown[counted], mine[counted]
        ratio = shown / mine
        middle = weighted_median(ratio, mine)
        if middle <= 0:
            return 0.0
        near = (ratio >= middle / _MOST_NOISE) & (ratio <= middle * _MOST_NOISE)
        return min(weighted_median(ratio[near], np.sqrt(shown[near] * mine[near])), _MOST_STRENGTH)

    def of_elements(self, observation: int) -> tuple[np.ndarray, np.ndarray]:
        """Return (E, 3) float32: the radiance of the elements in one observation, by the light of others.

        And (E,), the mean of the channels of what the same materials send of the lamp's own light.
        """
        lit = self._laid(self.exchange.lit[observation].astype(np.float32))
        given = {**self._inputs, "u_lit": textures.upload(np.repeat(lit[..., None], 4, axis=-1))}
        received, target = (textures.empty(*self._shape[::-1], value=0.0) for _ in range(2))
        constants = {
            "u_observation": observation, "u_ray_count": len(self.exchange.hits), "u_columns": self._shape[1]
        }  # fmt: skip
        branches = _BRANCHES if self._bounces > 1 else 0  # by which the last pass is two bounces
        passes = self._bounces - bool(branches)
        for left in reversed(range(passes)):
            last = left == 0
            bounce = {"u_to_camera": int(last), "u_branches": branches if last else 0}
            self._pass.run([target], {**given, "u_received": received}, constants | bounce)
            received, target = target, received
        found = textures.download(received).reshape(-1, 4)[: len(self.exchange.texels)]
        return found[:, :3], found[:, 3]

    def close(self) -> None:
        """Free shader and textures."""
        self._pass.close()
        self._inputs.clear()

    def _laid(self, values: np.ndarray) -> np.ndarray:
        """Return (h, w, …) of elements (E, …), zeros at the end."""
        laid = np.zeros((self._shape[0] * self._shape[1], *values.shape[1:]), values.dtype)
        laid[: len(values)] = values
        return laid.reshape(*self._shape, *values.shape[1:])

    def _materials(
        self, model: ReflectanceModel, values: Mapping[str, np.ndarray], known: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Return parameter name → (E, components) of all elements: their own, or those of the nearest known one."""
        texels = self.exchange.texels
        alike = self._nearest(_flat(known)[texels])
        found = {}
        for p in model.parameters:
            found[p.name] = _flat(values[p.name])[texels[alike]]
            if p.is_normal:
                own = _flat(self._domain.solvable)[texels, None]
                found[p.name] = np.where(own, _flat(values[p.name])[texels], np.array((0, 0, 1), np.float32))
        return found

    def _nearest(self, known: np.ndarray) -> np.ndarray:
        """Return (E,) for each element the nearest known one: itself, where it is."""
        places = _flat(self._domain.bake.position)[self.exchange.texels]
        nearest, others = np.arange(len(places)), np.flatnonzero(known)
        missing = np.flatnonzero(~known)
        for part in np.array_split(missing, -(-len(missing) * len(others) // _CHUNK) or 1):
            squared = ((places[part, None] - places[others]) ** 2).sum(axis=-1)
            nearest[part] = others[squared.argmin(axis=1)] if len(part) else part
        return nearest


def _flat(values: np.ndarray) -> np.ndarray:
    """(H·W, …) of (H, W, …)."""
    return values.reshape(-1, *values.shape[2:])


def _least(model: ReflectanceModel) -> dict[str, float]:
    """Return parameter name → the least value that light is found from."""
    roughness = _LEAST_ROUGHNESS**2 if model.material.get("roughness") == "alpha" else _LEAST_ROUGHNESS
    least = {p.name: roughness for p in model.parameters if "Roughness" in p.socket}
    return least | {p.name: _LEAST_ALBEDO for p in model.parameters if p.is_albedo}
