"""Pictures of a recovery: the maps against the truth, renders against references."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..capture.types import Capture
from ..geometry.domain import Domain
from ..maps.encode import srgb_from_linear
from ..maps.false_color import false_color
from ..maps.pictures import PreviewRow, default_maximum, display_image, gallery, preview
from ..maps.report import error_unit, parameter_error
from ..maps.result import UNKNOWN, Maps
from ..maps.tables import map_tables
from ..reflectance.model import load_model
from .forward import render_domain

_HIGHLIGHT = 1.5  # a sample is one's that is brighter than the diffuse reflection by this factor …
_DARK = 0.02  # … and by so much of what is shown as white, which is more than noise
_SHOWN = 3  # observations in a preview, the median one among them
_STRIPE = (0.93, 0.45, 0.12)
_WHITE = 99.5  # percentile of the reference that is shown as white


def error_preview(
    domain: Domain, maps: Maps, truth: Mapping[str, np.ndarray] | None, names: Sequence[str]
) -> np.ndarray:
    """Return (H, W, 3) display values: reference | recovered | error, of maps that are known, then of images.

    names: of all observations.
    """
    rows = map_rows(maps, truth, maps.covered) if truth else []
    counted = (layer[layer[..., 3] > 0] for layer in domain.stack)
    order = np.argsort([samples[:, :3].mean() if len(samples) else 0.0 for samples in counted])[::-1]
    # The brightest fifth and the middle: frames that show something, under unlike lights.
    chosen = [int(order[i]) for i in np.linspace(0, 0.6 * (len(order) - 1), _SHOWN).astype(int)]
    if rows:
        chosen = chosen[:1]
    rows += image_rows(domain, maps, chosen, [names[k] for k in chosen])
    return preview(rows, ("Reference", "Recovered", "Error"))


def relit_preview(
    domain: Domain, maps: Maps, held_out: Sequence[int], capture: Capture
) -> tuple[dict[str, np.ndarray], dict]:
    """Return the picture "relit" of observations that were left out of the fit, and figures for the report.

    These are their PSNR, and that of their highlights alone, in dB; None where there is nothing to compare.
    """
    if not held_out:
        return {}, {}
    names = [capture.observations[k].name for k in held_out]
    rows = image_rows(domain, maps, held_out, names)
    bright = _highlights(domain, maps, held_out)
    figures = {
        "relighting_psnr_db": dict(zip(names, map(_decibels, rows), strict=True)),
        "relighting_highlights_psnr_db": {
            name: _decibels(replace(row, counted=row.judged & where))
            for name, row, where in zip(names, rows, bright, strict=True)
        },
    }
    return {"relit": preview(rows, ("Photograph", "Relit", "Error"))}, figures


def confidence_preview(maps: Maps) -> dict[str, np.ndarray]:
    """Return the picture "confidence": each searched number, striped where the photographs do not tell it, and its σ.

    Nothing where the maps have no confidence, or the model no such number.
    """
    images, labels = [], []
    for name, unknown in maps.unknown().items():
        p = maps.model.parameter(name)
        deviation = maps.confidence[name][..., 0]
        red = UNKNOWN * (p.range[1] - p.range[0])
        images += [
            _striped(display_image([p], [maps.values[name]]), unknown),
            false_color(deviation, red, maps.covered),
        ]
        labels += [_title(name), f"± one sigma (red: {red:.2g})"]
    if not images:
        return {}
    return {"confidence": gallery("Striped: the photographs do not tell", images, labels, maps.covered)}


def _striped(image: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Return an image (H, W, 3) with diagonal stripes over some texels, of a colour that no grey map has."""
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
    residual = 100 * maps.residual
    maximum = default_maximum([residual], maps.covered)
    images.append(false_color(residual, maximum, maps.covered))
    labels.append(f"Residual (red: {maximum:g} %)")
    return gallery(heading, images, labels, maps.covered)


def map_rows(maps: Maps, truth: Mapping[str, np.ndarray], covered: np.ndarray) -> list[PreviewRow]:
    """Return a row for each map that the truth holds."""
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


def image_rows(domain: Domain, maps: Maps, observations: Sequence[int], labels: Sequence[str]) -> list[PreviewRow]:
    """Return a row for each observation: the photograph, as the maps render it, and the difference in % of white.

    Samples without weight are shown as they were photographed; their difference is not. Clipped ones differ where the
    render is darker: both pictures end at white.
    """
    rows = []
    renders = render_domain(domain, maps.model, maps.values, observations)
    for k, label, render in zip(observations, labels, renders, strict=True):
        seen, weight = np.nan_to_num(domain.stack[k, ..., :3]), domain.stack[k, ..., 3] != 0
        # Texels that no light told anything of, as a black background, have no material to be rendered.
        rendered = np.where(maps.covered[..., None], render[..., :3], 0)
        white = float(np.percentile(seen[weight], _WHITE)) if weight.any() else 1.0
        images = [srgb_from_linear(np.clip(image / max(white, 1e-6), 0, 1)) for image in (seen, rendered)]
        error = 100 * np.abs(images[0] - images[1]).mean(axis=-1)
        photographed = maps.covered if domain.card else maps.covered & (weight | (seen > 0).any(axis=-1))
        rows.append(PreviewRow(label, *images, error, "%", photographed, maps.covered & weight))
    return rows


def _highlights(domain: Domain, maps: Maps, observations: Sequence[int]) -> Iterator[np.ndarray]:
    """Yield (H, W) bool for each observation: where its photograph is far above what the maps reflect diffusely.

    That is Lambert's law for the base colours as far as they are no metal's: no highlight that the fit has missed is
    left out for being missed.
    """
    normal = next(p.name for p in maps.model.parameters if p.is_normal)
    diffuse = np.zeros((*domain.shape, 3), np.float32)
    for parameter in maps.model.parameters:
        if parameter.is_albedo:
            diffuse += maps.values[parameter.name]
    for parameter in maps.model.parameters:
        if parameter.socket == "Metallic":
            diffuse *= 1 - maps.values[parameter.name]
    values = {"base_color": diffuse, "normal": maps.values[normal]}
    renders = render_domain(domain, load_model("lambert"), values, observations)
    for k, render in zip(observations, renders, strict=True):
        seen = np.nan_to_num(domain.stack[k, ..., :3]).mean(axis=-1)
        yield seen > _HIGHLIGHT * render[..., :3].mean(axis=-1) + _DARK * np.percentile(seen[maps.covered], _WHITE)


def _title(name: str) -> str:
    return name.replace("_", " ").capitalize()


def image_psnr(row: PreviewRow) -> float:
    """Return the peak signal-to-noise ratio in dB of sRGB-encoded values, white the peak, where the error counts."""
    difference = (np.asarray(row.reference, np.float64) - row.recovered)[row.judged]
    return float(-10 * np.log10(max(float((difference**2).mean()), 1e-12))) if difference.size else float("nan")


def _decibels(row: PreviewRow) -> float | None:
    psnr = image_psnr(row)
    return round(psnr, 3) if np.isfinite(psnr) else None
