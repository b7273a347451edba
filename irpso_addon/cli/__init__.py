"""Command line: one parser for ``blender --command irpso …`` and ``python -m irpso_addon …``."""

from .parser import build_parser
from .run import main

__all__ = ["build_parser", "main"]
