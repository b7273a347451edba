"""``tile RESULT``: makes a card's result repeat without a seam."""

from __future__ import annotations

import sys
from argparse import Namespace
from pathlib import Path

from ..blender.materials import material, result_blend
from ..core.errors import InputError
from ..exports.result import Result, read_result
from ..exports.tile import Tile, tiled
from ..results.maps import Maps
from ..results.write import check_output_folder, check_replaces_nothing, write_maps
from .options.values import silent

_SIZES = (16, 8192)  # texels of a side


def run(options: Namespace) -> dict:
    """Cut all maps along one path, and write them as a result. Raises InputError and then writes nothing."""
    result = read_result(options.result, options.model)
    folder = _checked(options, result)
    tile = tiled(result.maps, result.height is not None, options.size, options.overlap)
    report = tile.report(result.report)
    write_maps(tile.maps, folder, report, {"repeated": tile.picture()}, tile.derived)
    _write_material(tile.maps, folder.resolve().name, folder)
    if not silent(options):
        sys.stdout.write(_summary(result.name, tile, folder))
    return {"output": str(folder), **report["tile"]}


def _checked(options: Namespace, result: Result) -> Path:
    """Return the output folder. Raises InputError where options or the result do not fit."""
    size, (least, most) = options.size, _SIZES
    if size is not None and not least <= size <= most:
        raise InputError(f"--size {size}: give a whole number from {least} to {most}, as 1024")
    if options.overlap is not None and not 0.05 <= options.overlap <= 0.5:
        raise InputError(f"--overlap {options.overlap:g}: give a share of the side from 0.05 to 0.5")
    if not result.card:
        raise InputError(f"{options.result}: its maps are those of a mesh, which cannot repeat; give a card's result")
    folder = check_output_folder(options.output)
    if folder.resolve() == Path(options.result).resolve():
        raise InputError(f"--output {options.output}: is the result itself; give another folder")
    check_replaces_nothing(folder, result.maps.model)
    return folder


def _write_material(maps: Maps, name: str, folder: Path) -> None:
    made = material.build_material(maps, name)
    material.apply_material(material.card_object(name, *maps.solved.shape), made)
    result_blend.save_result_blend(folder)


def _summary(name: str, tile: Tile, folder: Path) -> str:
    rows, (_, _, side), (across, up) = len(tile.maps.solved), tile.cut.crop, tile.cut.period
    return (
        f"{rows} × {rows} texels, written to {folder}; {across} × {up} of the {side} × {side} of {name} repeat\n"
        f"steps across the path are {tile.cut.seam:.2f} times those elsewhere (repeated as it is:"
        f" {tile.cut.plain:.2f})\n"
    )
