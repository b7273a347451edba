"""The GLSL files of a reflectance model: their texts, what they include, and the names that they may define."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

from ..core.errors import InputError
from ..core.paths import SHADERS

# The lower-case words of GLSL 4.60, section 3.6, that no field of a struct may have as its name.
_WORDS = re.compile(
    "active|asm|attribute|bool|break|buffer|case|cast|centroid|class|coherent|common|const|continue|default|discard|do"
    "|double|else|enum|extern|external|false|filter|fixed|flat|float|for|goto|half|highp|if|in|inline|inout|input|int"
    "|interface|invariant|layout|long|lowp|mediump|namespace|noinline|noperspective|out|output|partition|patch|precise"
    "|precision|public|readonly|resource|restrict|return|sample|sampler|shared|short|sizeof|smooth|static|struct"
    "|subroutine|superp|switch|template|this|true|typedef|uint|uniform|union|unsigned|using|varying|void|volatile|while"
    "|writeonly|[biudhf]?vec[234]|d?mat[234](x[234])?|atomic_uint|.*__.*"
)
_INCLUDE = re.compile(r'^[ \t]*#include[ \t]+"([^"\n]+)"', re.M)
_COMMENT = re.compile(r"//[^\n]*|/\*.*?\*/", re.S)
# A macro, a struct, or a function or constant outside of functions, which begins in the first column.
_DEFINITION = re.compile(r"^(?:#define[ \t]+|struct[ \t]+|(?:const[ \t]+)?\w+[ \t]+(?=\w+[ \t]*[(=\[]))(\w+)", re.M)
_MODEL_NAMES = re.compile("reflectance|basis_.*")  # that every model defines


def is_word(name: str) -> bool:
    """Return whether a name is a word of GLSL."""
    return _WORDS.fullmatch(name) is not None


def text_of(shader: Path) -> str:
    """Return the text of a GLSL file. Raises InputError if it cannot be read."""
    try:
        return shader.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{shader}: cannot be read ({error}); save it as UTF-8") from error


def files_of(shader: Path) -> list[Path]:
    """Return a GLSL file and all that it includes, from beside the including file or from shaders/."""
    files = [shader.resolve()]
    for file in files:
        for name in _INCLUDE.findall(text_of(file)):
            found = next((path.resolve() for path in (file.parent / name, SHADERS / name) if path.is_file()), None)
            if found is not None and found not in files:
                files.append(found)
    return files


def check_names(shader: Path) -> None:
    """Raise InputError if a user's shader, or a file of theirs that it includes, defines a name of the passes.

    Some passes are compiled only late in a recovery.
    """
    files = files_of(shader)
    theirs = [file for file in files if not file.is_relative_to(SHADERS)]
    taken = {name: file for file in _pass_files() if file not in files for name in _defined(file)}
    for file in theirs:
        for name in sorted(_defined(file) & taken.keys()):
            raise InputError(
                f"{file}: '{name}' is a name of the program ({taken[name].relative_to(SHADERS).as_posix()}); begin your"
                " own names with the model's name"
            )


@cache
def _pass_files() -> tuple[Path, ...]:
    """Return the shaders that are compiled together with a model; other models, beside their tables, are not."""
    return tuple(file for file in sorted(SHADERS.rglob("*.glsl")) if not file.with_suffix(".toml").is_file())


@cache
def _defined(file: Path) -> set[str]:
    """Return the names of macros, structs, functions and constants that a file defines, but those of every model."""
    names = _DEFINITION.findall(_COMMENT.sub("", text_of(file)))
    return {name for name in names if not _MODEL_NAMES.fullmatch(name)}
