"""Shader library: GLSL files with their includes expanded; #line marks give each line's file."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from ..core.errors import ShaderError
from ..core.files import INCLUDE, read_glsl
from ..core.paths import SHADERS


def read_source(path: str | Path, includes: Mapping[str, str | Path] = {}) -> str:
    """Return a GLSL file after the files it includes, each file once and whole, with #line marks.

    An include acts at the top of its file, wherever it stands: Blender's error messages use the last
    ``#line 1 "file"``, so every file must be one piece. The search order of names is ``includes`` (name → text, or the
    path of another file), the including file's folder, the shipped shaders/.
    Raises ShaderError with file and line where a name is not found, InputError where a file cannot be read.
    """
    return "\n".join(_expand(_find(str(path), None, includes, "shader library", 0), includes, set())) + "\n"


def _expand(source: Path | tuple[str, str], includes: Mapping[str, str | Path], seen: set) -> list[str]:
    seen.add(source)
    if isinstance(source, Path):
        # A short label: quotes or backslashes of a full path would break #line.
        own = re.sub(r"[^\w.-]", "_", source.name)  # #line and its readers end at blanks and quotes
        label = source.relative_to(SHADERS).as_posix() if source.is_relative_to(SHADERS) else own
        text, folder = read_glsl(source), source.parent
    else:
        label, text = source
        folder = None
    before: list[str] = []
    for match in INCLUDE.finditer(text):
        included = _find(match.group(1), folder, includes, label, text.count("\n", 0, match.start()) + 1)
        if included not in seen:
            before += _expand(included, includes, seen)
    return [*before, f'#line 1 "{label}"', INCLUDE.sub("", text).removesuffix("\n")]


def _find(
    name: str, folder: Path | None, includes: Mapping[str, str | Path], label: str, line: int
) -> Path | tuple[str, str]:
    if name in includes:
        value = includes[name]
        return value.resolve() if isinstance(value, Path) else (name, value)
    for path in (Path(name) if folder is None else folder / name, SHADERS / name):
        if path.is_file():
            return path.resolve()
    raise ShaderError(f'{label}:{line}: #include "{name}" names no file beside it or in shaders/')
