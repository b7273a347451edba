"""Converts options to settings; errors name the option."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from argparse import Namespace
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from shlex import quote
from typing import Any

import numpy as np

from ...capture.framing import AUTO
from ...core.errors import InputError
from ...core.udim import ONE_SQUARE
from ...exports.asset import Shelf
from ...reflectance.model import Parameter, ReflectanceModel
from ...results.read import read_parameter
from ...solver.settings.schedule import Schedule, load_schedule

MAX_SIDE = 16384
OF_ASSETS = ("asset_name", "catalog", "author", "license", "tag")  # options of an asset beside its library


def silent(options: Namespace) -> bool:
    """Return whether a command prints no progress: --quiet or --json."""
    return options.quiet or options.json


def shell_quoted(path: Path | str) -> str:
    """Return a path quoted for this system's shell, for printed commands."""
    return subprocess.list2cmdline([str(path)]) if os.name == "nt" else quote(str(path))


def warn_quietly(options: Namespace, warnings: Iterable[str]) -> None:
    """Print warnings if --quiet suppresses the summary with them; the result of --json has its own."""
    if options.quiet and not options.json:
        warn(warnings)


def warn(warnings: Iterable[str]) -> None:
    """Print warnings on standard error, a line each."""
    sys.stderr.write("".join(f"irpso: warning: {text}\n" for text in warnings))


def shelf_of(options: Namespace, library: str) -> Shelf:
    """Return the place of an asset in its library, and its metadata. Raises InputError."""
    words = (options.catalog or "", options.author or "", options.license or "")
    return Shelf(Path(library), *words, tuple(options.tag))


def check_shelf(options: Namespace, remedy: str) -> None:
    """Raise InputError for the options of ``shelf_of`` where no asset is written. remedy: how one would be."""
    for name in OF_ASSETS:
        if getattr(options, name):
            raise InputError(f"--{name.replace('_', '-')}: is of an asset; {remedy}, or leave the option out")


def size_option(option: str, text: str) -> tuple[int, int]:
    """Return (width, height) of "N" or "WxH". Raises InputError."""
    parts = text.lower().split("x")
    if len(parts) not in (1, 2) or not all(part.isdecimal() and 1 <= int(part) <= MAX_SIDE for part in parts):
        raise InputError(f"{option} {text}: give a whole number N, or WxH, each from 1 to {MAX_SIDE}")
    numbers = [int(part) for part in parts]
    return numbers[0], numbers[-1]


def positive(option: str, value: float | None) -> float | None:
    """Return an option's number above 0, None if it is not given. Raises InputError."""
    if value is not None and not 0 < value < math.inf:
        raise InputError(f"{option} {value:g}: give a number above 0")
    return value


def framing_from_options(options: Namespace) -> dict[str, Any]:
    """Return the given fields of a capture's Framing. Raises InputError."""
    if options.crop is not None and options.corners is not None:
        raise InputError("--crop and --corners: give one of them")
    changes: dict[str, Any] = {}
    if options.crop is not None:
        numbers = _numbers("--crop", options.crop, 4, "X,Y,WIDTH,HEIGHT in pixels from the upper left corner")
        changes |= {"crop": numbers, "corners": None}
    if options.corners == AUTO:
        changes |= {"corners": AUTO, "crop": None}
    elif options.corners is not None:
        form = "auto, or X1,Y1,…,X4,Y4 in pixels from the upper left corner"
        numbers = _numbers("--corners", options.corners, 8, form)
        changes |= {"corners": tuple(zip(numbers[::2], numbers[1::2], strict=True)), "crop": None}
    for name in ("scale", "card_width"):
        if getattr(options, name) is not None:
            changes[name] = getattr(options, name)
    return changes


def _numbers(option: str, text: str, count: int, form: str) -> tuple[float, ...]:
    numbers = numbers_of_text(text) or []
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise InputError(f"{option} {text}: give {form}")
    return tuple(numbers)


def schedule_from_options(options: Namespace) -> Schedule:
    """Return the preset with the changes of --set, --search and --iterations. Raises InputError."""
    schedule = load_schedule(options.preset)
    changes = {}
    for text in options.set:
        name, equals, value = text.partition("=")
        if not equals:
            raise InputError(f"--set {text}: write NAME=VALUE, as in --set particles=12")
        changes[name.strip()] = _number_or_text(value.strip())
    if options.search:
        changes["search"] = [name.strip() for name in options.search.split(",")]
    if options.iterations is not None:
        changes["iterations"] = options.iterations
    return schedule.replaced(**changes)


def fixed_from_options(
    texts: Sequence[str], model: ReflectanceModel, tiles: Sequence[int] = ONE_SQUARE
) -> dict[str, np.ndarray]:
    """Return the maps of --fixed NAME=VALUE: (H, W, components) from a file, or (components,) from numbers.

    tiles: the UDIM tiles of the domain; each has a file, as in normal=normal.<UDIM>.exr.
    """
    fixed = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals:
            raise InputError(f"--fixed {text}: write NAME=VALUE, as in roughness=0.5 or normal=file.exr")
        parameter = model.parameter(name.strip())
        numbers = numbers_of_text(value)
        fixed[parameter.name] = (
            read_parameter(Path(value.strip()), model, parameter.name, tiles)
            if numbers is None
            else _fixed_numbers(f"--fixed {text}", numbers, parameter)
        )
    return fixed


def check_size(option: str, maps: Mapping[str, np.ndarray], shape: tuple[int, int]) -> None:
    """Raise InputError, naming the option, if a map does not have the domain's shape (H, W)."""
    height, width = shape
    for name, value in maps.items():
        if value.ndim == 3 and value.shape[:2] != shape:
            raise InputError(
                f"{option}: {name} is {value.shape[1]} × {value.shape[0]}, the domain {width} × {height}; resample it"
            )


def _fixed_numbers(option: str, numbers: list[float], parameter: Parameter) -> np.ndarray:
    """Return (components,) float32 of numbers that hold at all texels."""
    count, (low, high) = parameter.components, parameter.range
    if len(numbers) not in ((count,) if parameter.is_normal else (1, count)):
        raise InputError(f"{option}: {parameter.name} has {count} numbers; give them separated by commas")
    if not np.isfinite(numbers).all():
        raise InputError(f"{option}: that is no finite number; give one between {low:g} and {high:g}")
    if min(numbers) < low or max(numbers) > high:
        raise InputError(f"{option}: {parameter.name} lies between {low:g} and {high:g}; give a value inside")
    values = np.resize(np.asarray(numbers, np.float64), count)
    if parameter.is_normal:
        if not 0.99 < np.linalg.norm(values) < 1.01:
            raise InputError(f"{option}: a normal has the length 1, as in {parameter.name}=0,0,1")
        values /= np.linalg.norm(values)
    return values.astype(np.float32)


def numbers_of_text(text: str) -> list[float] | None:
    """Return the numbers of "a,b,…", NaN and infinity included; None for other text."""
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        return None


def _number_or_text(text: str) -> bool | int | float | str:
    if text in ("true", "false"):
        return text == "true"
    for kind in (int, float):
        try:
            number = kind(text)
        except ValueError:
            continue
        if -math.inf < number < math.inf:
            return number
    return text
