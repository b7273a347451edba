"""Narrowing of optional types to values that are set."""

from __future__ import annotations

from typing import TypeVar

T = TypeVar("T")


def present(value: T | None) -> T:
    """Return the value. Raises ValueError for None."""
    if value is None:
        raise ValueError("a value is used before it is set")
    return value
