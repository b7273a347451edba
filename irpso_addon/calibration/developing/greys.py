"""Response curves from greys in one photograph: given patches, or the grey row of a colour chart."""

from __future__ import annotations

import numpy as np

from ...capture.images.image import ImageRef, ImageStore
from ...core.errors import InputError
from ..charts.search import find_chart
from ..radiometry.colour_chart import patch_colours
from ..radiometry.colour_fit import GREY, sample_chart
from ..radiometry.frames import Patch, patch_mean, read_codes, read_frame
from ..radiometry.response import Response, measurable, response_from_patches

AUTO = "auto"
# Greys alone do not separate gloss from the curve: base colours by a varnished chart were off by ΔE2000 4.7.
MATT_ONLY = (
    "the curve is right only if the chart is matt, which its greys do not show; if it is varnished, use brackets"
)


def patch_response(store: ImageStore, image: ImageRef, patches: tuple[Patch, ...]) -> Response:
    """Return the response curve by grey patches of known reflectance in one photograph.

    Raises InputError, also for a patch of which more than 2 % are clipped.
    """
    if any(patch.reflectance is None for patch in patches):
        raise InputError("--grey-card: give each patch's reflectance, as in --grey-card 100,220,40,40=0.18")
    codes, weight = read_codes(store, image), read_frame(store, image).curve_weight
    means = [patch_mean(codes, weight, patch, f"--grey-card: {image}") for patch in patches]
    return response_from_patches(np.array(means), [patch.reflectance or 0.0 for patch in patches])


def grey_row_response(store: ImageStore, image: ImageRef) -> Response | None:
    """Return the response curve by the grey row of the 24-patch chart in a photograph; None if it shows no chart.

    The search for the chart and its uneven illumination assume the file's stated curve. Raises InputError if fewer than
    two greys are neither clipped nor black.
    """
    codes, frame = read_codes(store, image), read_frame(store, image)
    where = f"--grey-card auto: {image}"
    found = find_chart(np.concatenate([frame.rgb, frame.weight[..., None]], axis=-1), where)
    if found is None:
        return None
    coded = np.concatenate([codes, frame.curve_weight[..., None]], axis=-1)
    chart = sample_chart(coded, found.corners, where)
    radiance = np.exp(chart.places @ found.fit.shading) * patch_colours().reshape(-1, 3).mean(axis=-1)
    usable = np.flatnonzero((chart.usable & measurable(chart.values))[GREY]) + GREY.start
    return response_from_patches(chart.values[usable], radiance[usable].tolist())
