"""``markers``: writes a marker board to print."""

from __future__ import annotations

import sys
from argparse import Namespace
from pathlib import Path

from ..capture.frame.board import board_of, write_board
from .options.values import silent


def run(options: Namespace) -> dict:
    """Write the board. Raises InputError and then writes nothing."""
    board, path = board_of(options.paper, options.count), Path(options.output)
    write_board(board, path)
    width, height = board.field
    if not silent(options):
        sys.stdout.write(f"{path}: {board.name}, field {width:g} × {height:g} mm; print it at 100 %\n")
    return {"output": str(path), "field": [width, height]}
