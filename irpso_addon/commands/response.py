"""``response PHOTOGRAPHS``: measures a camera's response curve from brackets or from grey patches."""

from __future__ import annotations

import sys
from argparse import Namespace
from pathlib import Path

import numpy as np

from ..blender.images import decode
from ..calibration.developing.greys import AUTO, MATT_ONLY, grey_row_response, patch_response
from ..calibration.radiometry.curve_file import write_response
from ..calibration.radiometry.frames import Patch, read_codes
from ..calibration.radiometry.response import Response, bracket_step, response_from_brackets
from ..calibration.radiometry.source import Exposing, brackets_of_images, images_in
from ..capture.formats.diligent import is_mask
from ..capture.images.image import ImageRef, ImageStore
from ..core.errors import InputError
from ..core.files import check_unused
from ..core.progress_bar import ProgressBar
from .options.photographs import exposures_option, greys_option
from .options.values import silent, warn

_SAMPLES = 4000  # pixels from all brackets
_WIDE_STEP = 1.6  # stops: with wider steps only the smoothness term determines a part of the curve


def run(options: Namespace) -> dict:
    """Write the curve and print its residual. Raises InputError."""
    path, store, file = Path(options.photographs), ImageStore(decode), Path(options.output)
    if file.suffix.lower() != ".toml":
        raise InputError(f"-o {file}: the curve is a .toml file; name it {file.with_suffix('.toml').name}")
    check_unused(file, "choose another name for -o")
    exposures = exposures_option(options.exposures, options.brackets)
    warnings: list[str] = []
    if options.grey_card:
        if options.brackets:
            raise InputError("--grey-card takes a curve from one photograph, --brackets from several; give one of them")
        greys = greys_option(options.grey_card)
        response = _from_greys(path, greys, store)
        warnings += [f"{path}: {MATT_ONLY}"] if greys == AUTO else []
    else:
        exposing = Exposing(options.brackets or "exif", True, exposures)
        response, warnings = _from_brackets(path, exposing, store, options)
    write_response(file, response)
    warn(warnings)
    ends = {name: [round(float(v), 4) for v in response.used[c]] for c, name in enumerate(("red", "green", "blue"))}
    residual = float(response.residual) if np.isfinite(response.residual) else None
    if not options.json:
        used = ", ".join(f"{name} {low:.3f} to {high:.3f}" for name, (low, high) in ends.items())
        known = "unknown" if residual is None else f"{residual:.2%}"
        sys.stdout.write(f"{options.output}: residual {known}, measured at codes of {used}\n")
    return {"output": options.output, "residual": residual, "used": ends, "warnings": warnings}


def _from_greys(path: Path, greys: tuple[Patch, ...] | str, store: ImageStore) -> Response:
    if not isinstance(greys, str):
        return patch_response(store, ImageRef(path), greys)
    if (response := grey_row_response(store, ImageRef(path))) is None:
        raise InputError(
            f"{path}: no 24-patch chart, whose grey row gives the curve, is found; photograph it whole, larger and"
            " evenly lit, or give grey patches as X,Y,W,H=REFLECTANCE"
        )
    return response


def _from_brackets(path: Path, exposing: Exposing, store: ImageStore, options: Namespace) -> tuple[Response, list[str]]:
    if not path.is_dir():
        raise InputError(f"{path}: is no folder of brackets; give one, or a photograph with --grey-card")
    brackets, warnings = brackets_of_images([p for p in images_in(path) if not is_mask(p)], exposing)
    bar = ProgressBar("response", silent(options))
    samples, exposures = [], []
    brackets = [bracket for bracket in brackets if len(bracket.paths) > 1]
    for k, bracket in enumerate(brackets):
        bar.show(k / len(brackets), bracket.name)
        codes = [read_codes(store, ImageRef(p)) for p in bracket.paths]
        if len({one.shape for one in codes}) > 1:
            raise InputError(f"{bracket.paths[0]}: the sizes in its bracket differ; do not crop photographs")
        samples.append(spread_samples(np.stack(codes, axis=-2), _SAMPLES // len(brackets)))
        exposures.append(np.array(bracket.amounts))
    bar.show(1.0)
    bar.close()
    step = bracket_step(exposures)
    if step > _WIDE_STEP:
        warnings.append(
            f"{path}: exposures are {step:.1f} stops apart, which leaves much of the curve undetermined;"
            " photograph brackets with steps of one stop"
        )
    return response_from_brackets(samples, exposures), warnings


def spread_samples(codes: np.ndarray, count: int) -> np.ndarray:
    """Return (N, F, 3): at most ``count`` pixels of (H, W, F, 3), evenly distributed over brightness.

    Pixels at edges are left out, because brackets move slightly.
    """
    height, width, frames, _ = codes.shape
    middle = codes[:, :, frames // 2].mean(axis=-1)
    slopes = [np.gradient(middle, axis=axis) for axis in (0, 1) if middle.shape[axis] > 1]
    rough = np.hypot.reduce([np.zeros_like(middle), *slopes])
    flat = codes.reshape(-1, frames, 3)
    smooth = np.flatnonzero((rough <= np.quantile(rough, 0.7)).ravel())
    order = smooth[np.argsort(flat[smooth].mean(axis=(1, 2)), kind="stable")]
    return flat[order[np.linspace(0, len(order) - 1, min(count, len(order))).astype(int)]]
