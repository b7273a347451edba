"""report.json: settings, environment, time, and errors of the result."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from ..gpu.versions import versions
from ..reflectance.model import Parameter
from .maps import Maps

_LIMIT_NEAR, _LIMIT_SHARE = 1e-3, 0.1  # relative distance to the limit; fraction of the solved texels
UNIT_LENGTH = 0.1  # a normal of ground truth whose length differs from 1 by more is none
_MODES_SHARE = 0.05  # fraction of the solved texels


def build_report(
    maps: Maps,
    *,
    settings: Mapping[str, Any],
    seed: int,
    gpu: str,
    iterations: int,
    evaluations: int,
    seconds: Mapping[str, float],
    ground_truth: Mapping[str, np.ndarray] | None = None,
    evaluated: np.ndarray | None = None,
    noise: float = 0.0,
) -> dict[str, Any]:
    """Return the report as plain data, ready for JSON.

    gpu: the renderer's name. seconds: phase → wall-clock seconds. ground_truth: parameter name → (H, W, C) in the
    parameter's units, row 0 at the bottom. evaluated: (H, W) bool, texels of the error statistics, by default the
    solved ones; the report has the excluded fraction. noise: the domain's, reported in 8-bit codes unless 0.
    """
    texels = maps.solved if evaluated is None else maps.solved & evaluated
    covered = int(maps.solved.sum())
    report: dict[str, Any] = {
        "model": maps.model.name,
        "settings": plain(settings),
        "seed": int(seed),
        "versions": versions(),
        "gpu": gpu,
        "size": [int(n) for n in maps.solved.shape[::-1]],
        "texels": covered,
        "excluded_fraction": round(1 - int(texels.sum()) / covered, 6) if covered else 0.0,
        "iterations": int(iterations),
        "evaluations": int(evaluations),
        "seconds": {phase: round(float(value), 3) for phase, value in seconds.items()},
    }
    if noise:
        report["noise_codes"] = round(255 * noise, 2)
    if maps.residual is not None:
        report["residual"] = quantiles(np.asarray(maps.residual).reshape(maps.solved.shape)[texels])
    if covered and (unknown := maps.unknown_by_cause()):
        shares = {
            name: {str(cause): int(mask.sum()) / covered for cause, mask in masks.items() if mask.any()}
            for name, masks in unknown.items()
        }
        report["unknown"] = {name: round(sum(causes.values(), 0.0), 4) for name, causes in shares.items()}
        report["unknown_causes"] = {
            name: {cause: round(share, 4) for cause, share in causes.items()} for name, causes in shares.items()
        }
    if maps.two_modes:
        report["two_modes"] = mode_shares(maps)
    if ground_truth is not None:
        report["ground_truth"] = ground_truth_errors(maps, ground_truth, texels)
    return report


def limit_warnings(maps: Maps, fixed: Collection[str] = ()) -> list[str]:
    """Return one line per albedo, not in ``fixed``, that is at its upper limit on many texels.

    No surface reflects more than all light. A capture with missing or wrong intensities is often brighter than a white
    surface, which biases normals (by 37° in the mean at five times the brightness).
    """
    lines = []
    for parameter in maps.model.parameters:
        if not parameter.is_albedo or parameter.name in fixed or not maps.solved.any():
            continue
        limit = parameter.range[1]
        share = float((maps.values[parameter.name][maps.solved].max(axis=-1) >= limit * (1 - _LIMIT_NEAR)).mean())
        if share > _LIMIT_SHARE:
            lines.append(
                f"{parameter.name} is at its limit {limit:g} on {share:.0%} of the texels: the images are brighter than"
                " the lights allow, and normals suffer; give the lights higher intensities"
            )
    return lines


def mode_shares(maps: Maps) -> dict[str, float]:
    """Return parameter name → fraction of the solved texels with two modes, for each tested parameter."""
    return {name: round(float(there[maps.solved].mean()), 4) for name, there in maps.two_modes.items()}


def mode_warnings(maps: Maps, priors: bool) -> list[str]:
    """Return one line per parameter with two modes on many texels. priors: whether priors were in use."""
    lines = []
    for name, share in mode_shares(maps).items():
        if share > _MODES_SHARE:
            decided = priors and maps.model.parameter(name).prior is not None
            lines.append(
                f"{name} of {share:.0%} of the texels has two possible values, far from each other: no photograph shows"
                f" a highlight that decides, and {'the prior decided' if decided else 'the map has one of the two'}."
                " Add lamps from more directions"
            )
    return lines


def prior_shares(maps: Maps, fixed: Collection[str] = ()) -> dict[str, float]:
    """Return, for each parameter with a prior and not in ``fixed``, the fraction of texels where the prior decided.

    A prior decides where its precision exceeds that of the samples. The maps' variance already contains a normal
    prior's precision: such a prior decides where more than half of its own variance remains.
    """
    return {name: _share(decided) for name, decided in _prior_decided(maps, fixed).items()}


def photograph_shares(maps: Maps, fixed: Collection[str] = ()) -> dict[str, float]:
    """Return, for the parameters of ``prior_shares``, the fraction of texels where the photographs decided.

    There the prior did not decide, and the value is not unknown.
    """
    unknown, shares = maps.unknown_by_cause(), {}
    for name, decided in _prior_decided(maps, fixed).items():
        masks = [mask[maps.solved] for mask in unknown.get(name, {}).values()]
        shares[name] = _share(~np.logical_or.reduce([decided, *masks]))
    return shares


def _share(texels: np.ndarray) -> float:
    return round(float(texels.mean()), 4)


def _prior_decided(maps: Maps, fixed: Collection[str]) -> dict[str, np.ndarray]:
    """Return (N,) bool over the solved texels by parameter, as described in ``prior_shares``."""
    model, result = maps.model, {}
    for p in model.parameters:
        if p.prior is None or p.name in fixed or maps.confidence is None or not maps.solved.any():
            continue
        place = None
        if p.prior.vanishes_with:
            other = model.parameter(p.prior.vanishes_with)
            place = (maps.values[other.name][maps.solved] - other.range[0]) / (other.range[1] - other.range[0])
        variance = p.prior.variance(maps.values[p.name][maps.solved], p.width, place)
        measured = np.square(maps.confidence[p.name][maps.solved])
        decided = (2 * measured if p.prior.kind == "normal" else measured) > variance
        result[p.name] = decided.any(axis=-1)
    return result


def ground_truth_errors(maps: Maps, truth: Mapping[str, np.ndarray], texels: np.ndarray) -> dict[str, Any]:
    """Return, for each parameter of the truth, the unit and quantiles of its error: degrees, or % of the range."""
    result = {}
    for parameter in maps.model.parameters:
        if parameter.name not in truth or parameter.name not in maps.values:
            continue
        error = parameter_error(parameter, maps.values[parameter.name], truth[parameter.name])
        result[parameter.name] = {"unit": error_unit(parameter), **quantiles(error[texels])}
    return result


def error_unit(parameter: Parameter) -> str:
    """Return the unit of ``parameter_error``: "°" or "%"."""
    return "°" if parameter.is_normal else "%"


def parameter_error(parameter: Parameter, values: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return (H, W) float64: the angle between normals in degrees, or the mean absolute difference in % of the range.

    NaN where the truth is undefined: a normal not of unit length to within 0.1, or a number that is not finite.
    """
    values = np.asarray(values, np.float64)
    truth = np.asarray(truth, np.float64).reshape(values.shape)
    if not parameter.is_normal:
        low, high = parameter.range
        return np.abs(values - truth).mean(axis=-1) * (100 / (high - low))
    length = np.linalg.norm(truth, axis=-1)
    # atan2 of cross and dot is precise at small angles, arccos of a rounded dot is not.
    cross = np.linalg.norm(np.cross(values, truth), axis=-1)
    angle = np.degrees(np.arctan2(cross, (values * truth).sum(axis=-1)))
    return np.where(np.abs(length - 1) < UNIT_LENGTH, angle, np.nan)


def quantiles(values: np.ndarray) -> dict[str, float | int | None]:
    """Return mean, median, 90th and 99th percentile, maximum and count of the finite numbers."""
    values = np.asarray(values, np.float64).ravel()
    finite = values[np.isfinite(values)]
    if not finite.size:
        return {"mean": None, "median": None, "p90": None, "p99": None, "max": None, "count": 0}
    median, p90, p99 = np.percentile(finite, (50, 90, 99))
    numbers = {"mean": finite.mean(), "median": median, "p90": p90, "p99": p99, "max": finite.max()}
    return {**{key: float(value) for key, value in numbers.items()}, "count": int(finite.size)}


def plain(value: Any) -> Any:
    """Convert a value for JSON: arrays become lists, non-finite numbers null, other objects text."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value if isinstance(value, str | int | float | bool | type(None)) else str(value)
