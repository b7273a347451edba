"""What panels are made of: wrapped text, numbers for people, a line of facts."""

from __future__ import annotations

import textwrap

import bpy

_CHARACTER = 6.6  # pixels of an average one at scale 1, in Blender's own font
_MARGINS = 58  # pixels of a panel's width that text does not get: edges, tab, icon
_GAPS = 45  # the same, without an icon
_LEAST = 16  # characters a line
_NAME = 0.4  # the part of a line that a fact's name takes


def wrapped(layout, context, text: str, icon: str = "NONE") -> None:
    """Draw a text over as many lines as the panel's width asks for, its icon before the first."""
    column = layout.column(align=True)
    column.scale_y = 0.8
    for line in textwrap.wrap(text, _characters(context)):
        column.label(text=line, icon=icon, translate=False)
        icon = "BLANK1" if icon != "NONE" else icon


def fact(layout, context, name: str, value: str, lines: int = 1) -> None:
    """Draw a name and what is true of it, over as many lines as that takes, and at least so many."""
    found = textwrap.wrap(value, int(_characters(context, _GAPS) * (1 - _NAME)))
    for line in found + [""] * (lines - len(found)):
        row = layout.split(factor=_NAME)
        left = row.row()
        left.alignment = "RIGHT"
        left.label(text=name)
        row.label(text=line, translate=False)
        name = ""


def redraw_sidebars() -> None:
    """Have the sidebars drawn anew, which is quick, and not the views that they lie on."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            for region in area.regions if area.type in ("VIEW_3D", "IMAGE_EDITOR") else ():
                if region.type == "UI":
                    region.tag_redraw()


def _characters(context, margins: int = _MARGINS) -> int:
    """Return how many characters a line of the panel has."""
    width = context.region.width if context.region is not None else 0
    scale = context.preferences.system.ui_scale or 1.0  # without a window there is none
    return max(_LEAST, int((width / scale - margins) / _CHARACTER))


def clock(seconds: float) -> str:
    """Return a duration as in "0:35", "12:03" or "1:02:03"."""
    whole = max(0, round(seconds))
    minutes = f"{whole // 60 % 60}:{whole % 60:02d}"
    return f"{whole // 3600}:{minutes:0>5}" if whole >= 3600 else minutes


def rate(evaluations: float) -> str:
    """Return evaluations per second in thousands or millions, as in "2.31 M/s"."""
    return f"{evaluations / 1e6:.2f} M/s" if evaluations >= 1e5 else f"{evaluations / 1e3:.1f} k/s"


def percent(error: float) -> str:
    """Return an error, a part of white, in per cent with three figures, as far as anybody could care."""
    value = 100 * error
    return f"{value:.3g} %" if value >= 0.001 else "< 0.001 %"
