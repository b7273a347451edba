"""``markers``: writes a sheet of markers to print."""

from __future__ import annotations

import sys
from argparse import Namespace
from pathlib import Path

from ..capture.frame.sheet import sheet_of, write_sheet
from .options.values import silent


def run(options: Namespace) -> dict:
    """Write the sheet. Raises InputError and then writes nothing."""
    sheet, path = sheet_of(options.paper, options.count), Path(options.output)
    write_sheet(sheet, path)
    width, height = sheet.field
    if not silent(options):
        sys.stdout.write(f"{path}: {sheet.name}, field {width:g} × {height:g} mm; print it at 100 %\n")
    return {"output": str(path), "field": [width, height]}
