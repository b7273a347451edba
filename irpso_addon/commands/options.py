"""Turning options of the command line into settings, with errors that name the option."""

from __future__ import annotations

import math
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..maps.read import read_parameter
from ..reflectance.model import ReflectanceModel
from ..solver.schedule import Schedule, load_schedule

LARGEST_SIDE = 16384


def size_option(option: str, text: str) -> tuple[int, int]:
    """Return (width, height) of "N" or "WxH". Raises InputError naming the option."""
    parts = text.lower().split("x")
    if len(parts) not in (1, 2) or not all(part.isdigit() and 1 <= int(part) <= LARGEST_SIDE for part in parts):
        raise InputError(f"{option} {text}: give a whole number N, or WxH, each from 1 to {LARGEST_SIDE}")
    numbers = [int(part) for part in parts]
    return numbers[0], numbers[-1]


def schedule_from_options(options: Namespace) -> Schedule:
    """Return the preset with the changes that --set, --search and --iterations ask for. Raises InputError."""
    schedule = load_schedule(options.preset)
    changes = {}
    for text in options.set:
        name, equals, value = text.partition("=")
        if not equals:
            raise InputError(f"--set {text}: write NAME=VALUE, as in --set particles=24")
        changes[name.strip()] = _number_or_text(value.strip())
    if options.search:
        changes["search"] = [name.strip() for name in options.search.split(",")]
    if options.iterations is not None:
        changes["iterations"] = options.iterations
    return schedule.replaced(**changes)


def known_from_options(texts: Sequence[str], model: ReflectanceModel) -> dict[str, np.ndarray]:
    """Return the maps of --known NAME=VALUE: (H, W, components) from a file, or (components,) from numbers."""
    known = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals:
            raise InputError(
                f"--known {text}: write NAME=VALUE, as in --known roughness=0.5 or --known normal=file.exr"
            )
        parameter = model.parameter(name.strip())
        numbers = [_number_or_text(part) for part in value.split(",")]
        if all(isinstance(number, int | float) for number in numbers):
            if len(numbers) not in (1, parameter.components):
                raise InputError(f"--known {text}: {parameter.name} has {parameter.components} numbers")
            known[parameter.name] = np.resize(np.asarray(numbers, np.float32), parameter.components)
            low, high = parameter.range
            if (known[parameter.name] < low).any() or (known[parameter.name] > high).any():
                raise InputError(f"--known {text}: {parameter.name} lies between {low:g} and {high:g}")
        else:
            known[parameter.name] = read_parameter(Path(value), parameter)
    return known


def index_list(option: str, text: str | None, count: int) -> list[int]:
    """Return the indices of "I,J,…", each below ``count``. Raises InputError naming the option."""
    if not text:
        return []
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isdigit() and int(part) < count for part in parts) or len(set(parts)) != len(parts):
        raise InputError(f"{option} {text}: give different numbers from 0 to {count - 1}, separated by commas")
    return [int(part) for part in parts]


def _number_or_text(text: str) -> int | float | str:
    for kind in (int, float):
        try:
            number = kind(text)
        except ValueError:
            continue
        if math.isfinite(number):
            return number
    return text
