"""Shader compilation, with errors that name file and line on every driver and Blender version."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from ..core.errors import ShaderError
from .output import caught_output

_COLOUR = re.compile(r"\x1b\[[0-9;]*m")  # Blender colours its log where the process has a terminal
_LOCATED = re.compile(r"[^|]+?:\d+:(?:\d+:)?\s*\S")  # echoed code has a | after its row
_ECHO = re.compile(r"[\s|]*?(\d+) \|")
# A place before the message is Blender's own mapping of the row to files, which is wrong in 4.2.
_MESSAGE = re.compile(r"[\s|]*(?:\S+:\d+:\d+: )?((?:\w+ )?(?:error|warning|note): .*)", re.IGNORECASE)
_STAGE = re.compile(r"(?:(Vert|Frag|Compute)Shader|Linking):\s*$")
_STAGES = {"Vert": "vertex", "Frag": "fragment", "Compute": "compute"}
_MARK = re.compile(r'#line 1 "([^"]+)"')
_NUMBERED = "#line 1 0\n"  # 4.5 needs it; 4.2 counts rows from it, 4.5 from the top of its own additions
_PADDING = "\n" * 8  # Blender does not echo rows near the end of the source
_WRONG = "irpso_first_row;\n"


def compile_shader(name: str | Path, make_info: Callable[[], Any], sources: Mapping[str, str]) -> Any:
    """Return the GPUShader of a create info and its sources. Raises ShaderError with file and line.

    make_info: returns a new GPUShaderCreateInfo without sources. sources: stage (vertex, fragment, compute) → GLSL text
    with the marks ``#line 1 "file"`` of ``library.read_source``.
    """
    shader, log = _attempt(make_info, {stage: _MARK.sub("", text) for stage, text in sources.items()})
    if shader is not None:
        return shader
    # Some drivers and versions accept marks with a file name; their log is complete.
    shader, named = _attempt(make_info, sources)
    if shader is None and any(f"{label}:" in named for text in sources.values() for label in _MARK.findall(text)):
        messages = messages_of(named)
    else:
        messages = _mapped(make_info, sources) or messages_of(log)
    raise ShaderError(f"shader '{name}' does not compile", messages)


def messages_of(log: str) -> str:
    """Return the lines ``file:line:column: message`` of Blender's log, without gutters and echoed code.

    A log without such lines (a linker's) is returned unchanged. Messages are unique.
    """
    log = _COLOUR.sub("", log)
    lines = [line.strip(" |\t") for line in log.splitlines()]
    return _errors([line for line in lines if _LOCATED.match(line)]) or log.strip()


def rows_of(log: str) -> Iterator[tuple[str | None, int | None, str]]:
    """Yield stage, row of the code echoed above (or None) and text of every message."""
    stage = row = None
    gutter = False
    for line in _COLOUR.sub("", log).splitlines():
        if header := _STAGE.search(line):
            stage, row = _STAGES.get(header[1]), None
        elif echo := _ECHO.match(line):
            row = int(echo[1])
        elif message := _MESSAGE.match(line):
            # Messages of one place are consecutive; a new place begins with an empty line, then its code.
            row = None if gutter else row
            yield stage, row, message[1].strip()
        gutter = not line.strip(" |\t")


def places_of(source: str) -> list[tuple[str, int]]:
    """Return the file and line of every row of a source, from the marks ``#line 1 "file"`` in it."""
    places, label, line = [], "", 0
    for text in source.splitlines():
        mark = _MARK.match(text)
        label, line = (mark[1], 0) if mark else (label, line + 1)
        places.append((label, max(1, line)))
    return places


def _mapped(make_info: Callable[[], Any], sources: Mapping[str, str]) -> str:
    """Return the messages of a compiler that counts rows over the full source, mapped to files and lines."""
    texts = {stage: _NUMBERED + _MARK.sub("", text) + _PADDING for stage, text in sources.items()}
    places = {stage: places_of(text) for stage, text in sources.items()}
    before: dict[str, int | None] = {}
    lines = []
    for stage, row, message in rows_of(_attempt(make_info, texts)[1]):
        if stage in places and stage not in before:
            before[stage] = _rows_before(make_info, texts, stage)
        if stage is not None and row is not None and (offset := before.get(stage)) is not None:
            index = min(max(row - offset, 1), len(places[stage])) - 1
            message = "{}:{}: {}".format(*places[stage][index], message)
        lines.append(message)
    return _errors(lines)


def _rows_before(make_info: Callable[[], Any], texts: Mapping[str, str], stage: str) -> int | None:
    """Return the offset of the log's row numbers, measured with a deliberately wrong row, or None."""
    wrong = {**texts, stage: _NUMBERED + _WRONG + texts[stage].removeprefix(_NUMBERED)}
    rows = [row for where, row, _ in rows_of(_attempt(make_info, wrong)[1]) if where == stage and row is not None]
    return rows[0] - 1 if rows else None


def _errors(lines: list[str]) -> str:
    """Return the unique errors among messages, or all messages where there is no error."""
    unique = dict.fromkeys(lines)
    return "\n".join([line for line in unique if "error:" in line.lower()] or unique)


def _attempt(make_info: Callable[[], Any], sources: Mapping[str, str]) -> tuple[Any, str]:
    """Compile; return the shader, or None and the log.

    Blender writes the log from C to the process's output, so this captures the output during compilation.
    """
    import gpu

    info = make_info()
    for stage, text in sources.items():
        getattr(info, f"{stage}_source")(text)
    with caught_output() as log:
        try:
            return gpu.shader.create_from_info(info), ""
        except Exception as error:  # noqa: BLE001  Blender raises Exception itself
            return None, log() or str(error)
