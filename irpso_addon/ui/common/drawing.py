"""Drawing helpers of the panels: wrapped text, rows of name and value, numbers as text."""

from __future__ import annotations

import re
import textwrap
import unicodedata

import bpy

_CHARACTER_WIDTH = 6.6  # pixels at scale 1: mean width in Blender's font
_MARGINS = 58  # pixels of a panel's width that hold no text: edges, tab, icon
_MARGINS_NO_ICON = 45  # the same in a row without an icon
_MIN_CHARACTERS = 16  # characters per line
_PIECES = re.compile(r"[!-~À-ɏ]+|[「『（【“]?.")  # Latin words and single characters
_CLOSING = "、。，．：；！？）」』】"
_NAME_FRACTION = 0.4  # fraction of a row's width for the name


def wrapped(layout, context, text: str, icon: str = "NONE") -> None:
    """Draw a text in the user's language, wrapped to the panel's width. The icon stands before the first line."""
    column = layout.column(align=True)
    column.scale_y = 0.8
    for line in lines_of(text, _characters(context)):
        column.label(text=line, icon=icon, translate=False)
        icon = "BLANK1" if icon != "NONE" else icon


def fact(layout, context, name: str, value: str, lines: int = 1) -> None:
    """Draw a name, which Blender translates, and its wrapped value. lines: the least number of lines to fill."""
    wrapped_lines = lines_of(value, int(_characters(context, _MARGINS_NO_ICON) * (1 - _NAME_FRACTION)))
    for line in wrapped_lines + [""] * (lines - len(wrapped_lines)):
        row = layout.split(factor=_NAME_FRACTION)
        left = row.row()
        left.alignment = "RIGHT"
        left.label(text=name)
        row.label(text=line, translate=False)
        name = ""


def lines_of(text: str, width: int) -> list[str]:
    """Wrap a text to lines of ``width`` Latin characters: at spaces, or between Chinese and Japanese characters.

    Each of these counts as two. No line begins with closing punctuation.
    """
    if not any(map(_is_wide, text)):
        return textwrap.wrap(text, width)
    lines, filled = [""], 0
    for piece in _PIECES.findall(text):
        taken = sum(2 if _is_wide(character) else 1 for character in piece)
        if filled + taken > width and lines[-1].strip() and piece not in _CLOSING:
            lines.append("")
            filled = 0
        lines[-1] += piece
        filled += taken
    return [line.strip() for line in lines]


def _is_wide(character: str) -> bool:
    return unicodedata.east_asian_width(character) in "WF"


def redraw_sidebars() -> None:
    """Redraw the sidebars only: redrawing the views behind them takes longer."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            for region in area.regions if area.type in ("VIEW_3D", "IMAGE_EDITOR") else ():
                if region.type == "UI":
                    region.tag_redraw()


def _characters(context, margins: int = _MARGINS) -> int:
    """Return the number of Latin characters in a line of the panel."""
    width = context.region.width if context.region is not None else 0
    scale = context.preferences.system.ui_scale or 1.0  # 0 without a window
    return max(_MIN_CHARACTERS, int((width / scale - margins) / _CHARACTER_WIDTH))


def clock(seconds: float) -> str:
    """Return a duration as in "0:35", "12:03" or "1:02:03"."""
    whole = max(0, round(seconds))
    minutes = f"{whole // 60 % 60}:{whole % 60:02d}"
    return f"{whole // 3600}:{minutes:0>5}" if whole >= 3600 else minutes


def rate(evaluations: float) -> str:
    """Return evaluations per second in thousands or millions, as in "2.31 M/s"."""
    return f"{evaluations / 1e6:.2f} M/s" if evaluations >= 1e5 else f"{evaluations / 1e3:.1f} k/s"


def percent(error: float) -> str:
    """Return an error (fraction of white) in percent, with three digits; below 0.001 % as "< 0.001 %"."""
    value = 100 * error
    return f"{value:.3g} %" if value >= 0.001 else "< 0.001 %"
