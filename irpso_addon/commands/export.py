"""``export RESULT``: writes a finished result in the formats of other programs."""

from __future__ import annotations

import sys
from argparse import Namespace
from functools import partial
from typing import Any

from ..blender.materials.gltf import result_object
from ..blender.scenes.scene import open_blend
from ..core.errors import InputError
from ..exports.asset import write_to_shelf
from ..exports.formats import export
from ..exports.names import ASSET, ONE_FILE, RELIEF, TURNTABLE, WEB
from ..exports.place import file_place, file_stem
from ..exports.relief import write_relief
from ..exports.result import Result, read_result, slots_of_result
from ..exports.turntable import write_turntable
from ..gpu import context, probe
from .options.occlusion import check_occlusion, with_occlusion
from .options.page import UNNAMED, names_photographs, page_photographs
from .options.values import check_shelf, shelf_of, silent, warn_quietly

_CONVENTION, _WIDTH = "blender", 100.0
_OF_OBJECTS = ("gltf", TURNTABLE, ASSET)
_OWNERS = {"convention": "textures", "photographs": WEB, "width": RELIEF}  # option → the format that has it


def run(options: Namespace) -> dict:
    """Read the result's folder and write it in the chosen format. Raises InputError."""
    check_occlusion(options)
    _check_options(options)
    result = read_result(options.result, options.model)
    if options.format == ASSET:
        return _asset(result, options)
    check_shelf(options, "export with --format asset")
    if options.format == RELIEF:
        report = write_relief(
            result, options.output, _WIDTH if options.width is None else options.width, options.replace
        )
        if not silent(options):
            sys.stdout.write(f"written to {report['output']}: {report['width']:g} wide, {report['depth']:.3g} deep\n")
        return report
    if options.format == TURNTABLE:
        report = write_turntable(result, options.output, lambda: _subject(result, options.object), options.replace)
        if not silent(options):
            sys.stdout.write(f"written to {report['output']}\n")
        return report
    if options.format == "ptm":
        probe.probe()
        context.ensure()
    subject = partial(_subject, result, options.object)
    if options.format == "gltf":  # checked before a slow bake
        file_place(options.output, file_stem(result.name), [ONE_FILE["gltf"]], options.replace)
    result = with_occlusion(result, options, subject)
    report = export(
        result,
        options.format,
        options.output,
        options.convention or _CONVENTION,
        subject,
        lambda: page_photographs(result, options),
        options.replace,
    )
    if options.format == WEB and options.photographs is None and not names_photographs(result):
        report["warnings"].append(f"no photographs: {UNNAMED}")
    warn_quietly(options, report.get("warnings", ()))
    if not silent(options):
        sys.stdout.write(_summary(report))
    return report


def _check_options(options: Namespace) -> None:
    """Raise InputError for an option of another format."""
    for name, owner in _OWNERS.items():
        if getattr(options, name) is not None and options.format != owner:
            raise InputError(f"--{name}: --format {options.format} has none; leave it out, or choose --format {owner}")
    if options.object and options.format not in _OF_OBJECTS and not options.occlusion:
        raise InputError(f"--object: --format {options.format} has none; leave it out")


def _asset(result: Result, options: Namespace) -> dict:
    shelf, name = shelf_of(options, options.output), options.asset_name or result.name
    shelf.path(name)
    subject = _subject(result, options.object)
    path = write_to_shelf(shelf, subject, name, slots_of_result(result, subject) or ())
    if not silent(options):
        sys.stdout.write(f"written to {path}\n")
    return {"output": str(path)}


def _subject(result: Result, name: str | None) -> Any:
    if result.blend is None:
        raise InputError(
            f"{result.folder}: holds no material.blend, so there is no mesh or material to export; recover again"
        )
    open_blend(str(result.blend))
    return result_object(name)


def _summary(report: dict[str, Any]) -> str:
    lines = [f"written to {report['output']}"]
    if "bytes" in report:
        lines += [f"{name}: {count / 1e6:.1f} MB" for name, count in report["bytes"].items() if count]
    for name, value in report.items():
        if isinstance(value, dict):
            numbers = {**value, **value.get("ward_error", {})}
            shown = {"mean": "error of the lobe", "psnr_db": "PSNR in dB"}
            lines += [
                f"{name}: {text} {numbers[key]:.4g}" for key, text in shown.items() if numbers.get(key) is not None
            ]
    lines += [f"warning: {text}" for text in report.get("warnings", ())]
    return "\n".join(lines) + "\n"
