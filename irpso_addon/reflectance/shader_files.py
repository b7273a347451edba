"""The GLSL files of a reflectance model: their texts, what they include, and the names that they may define."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

from ..core.errors import InputError
from ..core.files import INCLUDE, read_glsl
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
_COMMENT = re.compile(r"//[^\n]*|/\*.*?\*/", re.S)
_MACRO = re.compile(r"^[ \t]*#[ \t]*define[ \t]+(\w+)", re.M)
_DIRECTIVE = re.compile(r"^[ \t]*#.*$", re.M)
_BODY = re.compile(r"\{[^{}]*\}")
# Outside of bodies, which are "{}": a struct, a function, and the constants of a declaration.
_STRUCT_OR_FUNCTION = re.compile(r"\bstruct\s+(\w+)|(\w+)\s*\([^()]*\)\s*\{\}")
_CONSTANTS = re.compile(r"\bconst\b[^;]*;")
_CONSTANT = re.compile(r"(\w+)\s*(?:\[\w*\])?\s*=")
_MODEL_NAMES = re.compile("reflectance|basis_.*")  # that every model defines


def is_word(name: str) -> bool:
    """Return whether a name is a word of GLSL."""
    return _WORDS.fullmatch(name) is not None


def files_of(shader: Path) -> list[Path]:
    """Return a GLSL file and all that it includes, from beside the including file or from shaders/."""
    files = [shader.resolve()]
    for file in files:
        for name in INCLUDE.findall(read_glsl(file)):
            found = next((path.resolve() for path in (file.parent / name, SHADERS / name) if path.is_file()), None)
            if found is not None and found not in files:
                files.append(found)
    return files


def check_names(shader: Path) -> None:
    """Raise InputError if a user's shader, or a file of theirs that it includes, defines a name of the passes.

    Some passes are compiled only late in a recovery.
    """
    files = files_of(shader)
    taken = {name: file for file, names in _pass_names().items() if file not in files for name in names}
    for file in files:
        if file.is_relative_to(SHADERS):
            continue
        for name in sorted(_defined(file) & taken.keys()):
            raise InputError(
                f"{file}: '{name}' is a name of the program ({taken[name].relative_to(SHADERS).as_posix()}); begin your"
                " own names with the model's name"
            )


@cache
def _pass_names() -> dict[Path, set[str]]:
    """Return the names in the shaders that are compiled together with a model; others, beside tables, are models."""
    return {file: _defined(file) for file in sorted(SHADERS.rglob("*.glsl")) if not file.with_suffix(".toml").is_file()}


def _defined(file: Path) -> set[str]:
    """Return the names of macros, structs, functions and constants that a file defines, but those of every model."""
    text = _COMMENT.sub("", read_glsl(file))
    names = _MACRO.findall(text)
    text, flat = "", _DIRECTIVE.sub("", text)
    while flat != text:  # bodies inside bodies become blanks
        text, flat = flat, _BODY.sub(lambda body: "\x00", flat)
    flat = flat.replace("\x00", "{}")
    names += [struct or function for struct, function in _STRUCT_OR_FUNCTION.findall(flat)]
    names += [name for declaration in _CONSTANTS.findall(flat) for name in _CONSTANT.findall(declaration)]
    return {name for name in names if not _MODEL_NAMES.fullmatch(name)}
