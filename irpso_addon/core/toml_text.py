"""Values as TOML, which Python reads but does not write."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from .errors import InputError


def toml_value(value: Any) -> str:
    """Return TOML of text, numbers, booleans, lists, tables or numpy values; ``tomllib`` reads the same value.

    Raises InputError for text that is no Unicode, as a file's name of other bytes than UTF-8.
    """
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        if any("\ud800" <= letter <= "\udfff" for letter in value):
            raise InputError(f"{value!r}: this name is not valid UTF-8, which TOML files need; rename it")
        # A JSON string is a TOML basic string, but for the one control character that JSON lets through.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{json.dumps(k)} = {toml_value(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml_value(v) for v in value) + "]"
    return repr(value)  # the shortest text that reads back as the same number
