"""Pictures of a recovery: the maps against the truth, renders against references."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ...core.encode import srgb_from_linear
from ...core.optional import present
from ...geometry.domain import Domain
from ...results.false_color import false_color
from ...results.map_tables import map_tables
from ...results.maps import UNKNOWN, Maps
from ...results.preview import PreviewRow, default_maximum, display_image, gallery, on_one_scale, preview
from ...results.report import error_unit, parameter_error
from .forward import rendered

_SHOWN = 3  # observations in a preview, with the median one
_RANKED = 256  # texels along the shorter side from which the observations are chosen
_STRIPE = (0.93, 0.45, 0.12)
SHOWN_WHITE = 99.5  # percentile of the reference: display white

Indirect = Callable[[int], np.ndarray | float]


def no_indirect(observation: int) -> float:
    return 0.0


def error_preview(
    domain: Domain,
    maps: Maps,
    truth: Mapping[str, np.ndarray] | None,
    names: Sequence[str],
    indirect: Indirect = no_indirect,
) -> np.ndarray:
    """Return (H, W, 3) display values: reference | recovered | error, of maps with a truth, then of images.

    names: of all observations. indirect: as for ``image_rows``.
    """
    rows = map_rows(maps, truth, maps.solved) if truth else []
    step = max(1, min(domain.shape) // _RANKED)
    counted = (layer[layer[..., 3] > 0] for layer in (whole[::step, ::step] for whole in domain.stack.layers()))
    order = np.argsort([samples[:, :3].mean() if len(samples) else 0.0 for samples in counted])[::-1]
    # The brightest fifth and the middle: bright frames under different lights.
    chosen = [int(order[i]) for i in np.linspace(0, 0.6 * (len(order) - 1), _SHOWN).astype(int)]
    if rows:
        chosen = chosen[:1]
    rows += on_one_scale(image_rows(domain, maps, chosen, [names[k] for k in chosen], indirect))
    return preview(rows, ("Reference", "Recovered", "Error"))


def confidence_preview(maps: Maps) -> dict[str, np.ndarray]:
    """Return the picture "confidence": normals and searched numbers, striped where unknown, and their σ.

    {} without confidence, or if the model has no such parameter.
    """
    images, labels = [], []
    for name, unknown in maps.unknown().items():
        p = maps.model.parameter(name)
        deviation = (maps.confidence or {})[name][..., 0]
        red = UNKNOWN * p.width
        images += [_striped(display_image([p], [maps.values[name]]), unknown), false_color(deviation, red, maps.solved)]
        reading = f"{np.degrees(red):.3g}°" if p.is_normal else f"{red:.2g}"
        labels += [_title(name), f"± one sigma (red: {reading})"]
    if not images:
        return {}
    heading = "Striped: the photographs do not determine it"
    return {"confidence": gallery(heading, images, labels, maps.solved)}


def _striped(image: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Return an image (H, W, 3) with diagonal stripes over some texels, in a colour absent from grey maps."""
    rows, columns = np.indices(where.shape)
    period = max(4, max(where.shape) // 40)
    stripe = where & ((rows + columns) % period < (period + 1) // 2)
    return np.where(stripe[..., None], _STRIPE, image).astype(np.float32)


def maps_so_far(maps: Maps, heading: str) -> np.ndarray:
    """Return (H, W, 3) display values: every map of an unfinished recovery, then its residual in false colours."""
    images, labels = [], []
    for table in map_tables(maps.model):
        images.append(display_image(table.parameters, [maps.values[p.name] for p in table.parameters]))
        labels.append(_title(table.name))
    residual = 100 * present(maps.residual)
    maximum = default_maximum([residual], maps.solved)
    images.append(false_color(residual, maximum, maps.solved))
    labels.append(f"Residual (red: {maximum:g} %)")
    return gallery(heading, images, labels, maps.solved)


def map_rows(maps: Maps, truth: Mapping[str, np.ndarray], covered: np.ndarray) -> list[PreviewRow]:
    """Return one row per map in the truth."""
    rows = []
    for table in map_tables(maps.model):
        if not all(p.name in truth for p in table.parameters):
            continue
        names = [p.name for p in table.parameters]
        reference = display_image(table.parameters, [truth[name] for name in names])
        recovered = display_image(table.parameters, [maps.values[name] for name in names])
        errors = [parameter_error(p, maps.values[p.name], truth[p.name]) for p in table.parameters]
        unit = error_unit(table.parameters[0])
        rows.append(PreviewRow(_title(table.name), reference, recovered, np.mean(errors, axis=0), unit, covered))
    return rows


def image_rows(
    domain: Domain, maps: Maps, observations: Sequence[int], labels: Sequence[str], indirect: Indirect = no_indirect
) -> list[PreviewRow]:
    """Return the ``image_row`` of each observation. indirect: returns the light to add to a render."""
    rows = zip(observations, labels, rendered(domain, maps.model, maps.values, observations), strict=True)
    return [image_row(domain, maps, k, label, render[..., :3] + indirect(k)) for k, label, render in rows]


def image_row(domain: Domain, maps: Maps, k: int, label: str, render: np.ndarray) -> PreviewRow:
    """Return the photograph of an observation, its render (H, W, 3 or more), and the difference in % of white.

    Both have one exposure: white is the photograph's 99.5th percentile. Samples of weight 0 show the photograph,
    without a difference. Clipped samples differ only where the render is darker: both pictures are clipped at white.
    """
    layer = domain.stack.layer(k)
    samples, weight = np.nan_to_num(layer[..., :3]), layer[..., 3] != 0
    # Texels without a usable sample, such as a black background, have no material to render.
    rendered = np.where(maps.solved[..., None], render[..., :3], 0)
    white = display_white(layer)
    photograph, render = (srgb_from_linear(np.clip(image / white, 0, 1)) for image in (samples, rendered))
    error = 100 * np.abs(photograph - render).mean(axis=-1)
    photographed = maps.solved if domain.card else maps.solved & (weight | (samples > 0).any(axis=-1))
    return PreviewRow(label, photograph, render, error, "%", photographed, maps.solved & weight)


def display_white(layer: np.ndarray) -> float:
    """Return the radiance shown as white of a photograph's samples (H, W, 4): the 99.5th percentile of those with a
    weight; 1 without such samples."""
    counted = layer[layer[..., 3] != 0, :3]
    return max(float(np.percentile(np.nan_to_num(counted), SHOWN_WHITE)), 1e-6) if counted.size else 1.0


def _title(name: str) -> str:
    return name.replace("_", " ").capitalize()


def image_psnr(row: PreviewRow) -> float:
    """Return the PSNR in dB of sRGB-encoded values, with white as peak, over the texels whose error counts."""
    difference = (np.asarray(row.reference, np.float64) - row.recovered)[row.compared]
    return float(-10 * np.log10(max(float((difference**2).mean()), 1e-12))) if difference.size else float("nan")
