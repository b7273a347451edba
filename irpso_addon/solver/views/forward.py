"""The forward renderer, R(p̂) = ĉ of the paper: images from maps, geometry and lights."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing

import numpy as np

from ...capture.camera import Camera
from ...capture.types import Capture, Light, Observation
from ...geometry.domain import Domain, GeometryBake, tile
from ...gpu import context, textures
from ...gpu.textures import Texture
from ...reflectance.model import ReflectanceModel
from ..kernels.single_passes import render_pass
from ..state.textures import Estimates, geometry_layers, observation_defines, upload_observations


class Renderer:
    """Renders one material under many lights, without cast shadows and interreflection.

    bake: the surface at each pixel or texel. values: parameter name → (H, W, components). lights: (K, 4), intensities:
    (K, 3) and views: (K, 4) as in Domain. The solver inverts the same shaders.
    """

    def __init__(
        self,
        bake: GeometryBake,
        model: ReflectanceModel,
        values: Mapping[str, np.ndarray],
        lights: np.ndarray,
        intensities: np.ndarray,
        views: np.ndarray,
        card: bool = False,
    ):
        context.ensure()
        self._inputs = render_inputs(bake, model, values, lights, intensities, views)
        self._pass = render_pass(model, observation_defines(lights, views, card))
        height, width = bake.coverage.shape
        self._target = textures.empty(width, height)

    def render(self, observation: int) -> np.ndarray:
        """Return (H, W, 4) float32 linear radiance under one light; alpha is 1 on the surface."""
        self._pass.run([self._target], self._inputs, {"u_observation": observation})
        return textures.download(self._target)

    def close(self) -> None:
        """Free shader and textures."""
        self._pass.close()
        self._inputs.clear()
        del self._target


def render_inputs(
    bake: GeometryBake,
    model: ReflectanceModel,
    values: Mapping[str, np.ndarray],
    lights: np.ndarray,
    intensities: np.ndarray,
    views: np.ndarray,
) -> dict[str, Texture]:
    """Return the textures of a pass that renders maps and reads no samples; arguments as for Renderer."""
    state = bake.coverage.astype(np.float32)
    return {
        "u_geometry": textures.upload_layers(
            geometry_layers(bake.position, bake.normal, bake.tangent, state, np.ones_like(state))
        ),
        **Estimates(model, dict(values)).bindings(),
        "u_observation_table": upload_observations(lights, intensities, views),
        # Never read; Vulkan requires a binding for every declared sampler.
        "u_stack": textures.upload_layers(np.zeros((1, 1, 1, 4))),
    }


def camera_renderer(
    bake: GeometryBake,
    model: ReflectanceModel,
    values: Mapping[str, np.ndarray],
    camera: Camera,
    lights: Sequence[Light],
) -> Renderer:
    """Return the renderer of a camera's image: ``bake`` and ``values`` are per pixel."""
    table = np.array([[*light.vector, 0.0 if light.distant else 1.0] for light in lights])
    intensities = np.array([light.intensity for light in lights])
    return Renderer(bake, model, values, table, intensities, np.tile(camera.view, (len(lights), 1)))


def rendered(
    domain: Domain, model: ReflectanceModel, values: Mapping[str, np.ndarray], observations: Sequence[int]
) -> Iterator[np.ndarray]:
    """Yield the renders (H, W, 4) of maps in a domain's texels, one per observation.

    A domain larger than a texture, such as UDIM tiles side by side, is rendered in blocks, all images at once.
    """
    context.ensure()
    if max(domain.shape) > context.max_texture_size():
        yield from _rendered_in_blocks(domain, model, values, observations)
        return
    tables = domain.lights, domain.intensities, domain.views
    with closing(Renderer(domain.bake, model, values, *tables, domain.card)) as renderer:
        yield from map(renderer.render, observations)


def _rendered_in_blocks(
    domain: Domain, model: ReflectanceModel, values: Mapping[str, np.ndarray], observations: Sequence[int]
) -> list[np.ndarray]:
    side = context.max_texture_size()
    height, width = domain.shape
    images = [np.zeros((height, width, 4), np.float32) for _ in observations]
    for y in range(0, height, side):
        for x in range(0, width, side):
            part = tile(domain, x, y, min(side, width - x), min(side, height - y))
            block = slice(y, y + side), slice(x, x + side)
            values_in_block = {name: value[block] for name, value in values.items()}
            for image, render in zip(images, rendered(part, model, values_in_block, observations), strict=True):
                image[block] = render
    return images


def with_unit_normals(model: ReflectanceModel, values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return maps with normals of length 1; 0, 0, 0 stays."""
    lengths = {p.name: np.linalg.norm(values[p.name], axis=-1, keepdims=True) for p in model.parameters if p.is_normal}
    return {**values} | {name: values[name] / np.maximum(length, 1e-8) for name, length in lengths.items()}


def sampled(values: Mapping[str, np.ndarray], uv: np.ndarray, tiles: int = 1) -> dict[str, np.ndarray]:
    """Return maps (h, w, components) sampled bilinearly at texture coordinates (H, W, 2), as float32.

    Texel centres lie at (i + ½) / w; outside the outermost centres of a tile the border value is repeated. tiles:
    number of UDIM tiles side by side.
    """
    height, width = next(iter(values.values())).shape[:2]
    first = np.clip((uv[..., 0] * tiles).astype(int), 0, tiles - 1) * (width // tiles)
    last = first + width // tiles - 1
    x = np.clip(uv[..., 0] * width - 0.5, first, last)
    y = np.clip(uv[..., 1] * height - 0.5, 0, height - 1)
    x0, y0 = np.clip(x.astype(int), first, np.maximum(last - 1, first)), np.minimum(y.astype(int), max(height - 2, 0))
    x1, y1 = np.minimum(x0 + 1, last), np.minimum(y0 + 1, height - 1)
    fx, fy = (x - x0)[..., None], (y - y0)[..., None]
    result = {}
    for name, grid in values.items():
        lower = grid[y0, x0] * (1 - fx) + grid[y0, x1] * fx
        upper = grid[y1, x0] * (1 - fx) + grid[y1, x1] * fx
        result[name] = (lower * (1 - fy) + upper * fy).astype(np.float32)
    return result


def rendered_capture(
    name: str,
    renderers: Sequence[Renderer],
    cameras: Sequence[Camera],
    masks: Sequence[np.ndarray],
    lights: Sequence[Light],
    report: Callable[[float], None] = lambda fraction: None,
) -> Capture:
    """Return the capture of every camera under every light; reading an image renders it.

    renderers, masks: one per camera, with all lights. report: called at each image with the fraction rendered.
    """
    count = len(cameras) * len(lights)

    def reader(camera: int, k: int) -> Callable[[], np.ndarray]:
        def read() -> np.ndarray:
            image = renderers[camera].render(k)
            image[..., 3] = 1
            report((camera * len(lights) + k + 1) / count)
            return image

        return read

    observations = tuple(
        Observation(f"camera {camera + 1} light {k + 1}", reader(camera, k), light, camera)
        for camera in range(len(cameras))
        for k, light in enumerate(lights)
    )
    return Capture(name, observations, tuple(cameras), tuple(masks))


def dome(latitudes: int, longitudes: int) -> np.ndarray:
    """Return (latitudes · longitudes, 3) unit directions on rings at the midpoints of equal latitude steps, pole +Z."""
    polar = (np.arange(latitudes) + 0.5) * np.pi / latitudes
    around = np.arange(longitudes) * 2 * np.pi / longitudes
    polar, around = (grid.ravel() for grid in np.meshgrid(polar, around, indexing="ij"))
    return np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=-1)
