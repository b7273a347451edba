"""Occlusion of a result: of a card from its relief, of a mesh baked on the object in its .blend."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from ...blender.mesh import extract_mesh
from ...blender.occluders import named_occluders, with_occluders
from ...blender.occlusion import RAYS, mesh_open_sky
from ...core.errors import InputError
from ...exports.names import OCCLUDED
from ...exports.result import Result, slots_of_result

_MAX_RAYS = 4096


def check_occlusion(options: Namespace) -> None:
    """Raise InputError where options of occlusion contradict others."""
    for option, is_set in (("--rays", options.rays is not None), ("--occluder", options.occluder)):
        if is_set and not options.occlusion:
            raise InputError(f"{option}: applies to a mesh's occlusion; give --occlusion as well")
    if options.occlusion and options.format not in OCCLUDED:
        raise InputError(
            f"--occlusion: --format {options.format} has no occlusion; choose one of {', '.join(OCCLUDED)}"
        )
    if options.rays is not None and not 1 <= options.rays <= _MAX_RAYS:
        raise InputError(f"--rays {options.rays}: give a whole number from 1 to {_MAX_RAYS}")


def with_occlusion(result: Result, options: Namespace, subject: Callable[[], Any]) -> Result:
    """Return the result with --occlusion. subject: opens the result's .blend and returns the object with its material.

    Raises InputError.
    """
    if not options.occlusion:
        return result
    if result.card:
        if result.height is None:
            raise InputError(f"--occlusion: {result.folder} has no height to compute it from; recover with --height")
        if options.occluder or options.rays is not None:
            raise InputError(
                "--occluder and --rays: apply to a mesh; leave them out, a card's occlusion is that of its relief"
            )
        return result
    obj = subject()
    mesh = extract_mesh(obj, slots_of_result(result, obj))
    mesh = with_occluders(mesh, named_occluders(options.occluder, obj, "--occluder"))
    return replace(result, baked_sky=mesh_open_sky(mesh, result.maps, options.rays or RAYS))
