"""Work in steps: a generator that yields before each piece, for callers that must not wait."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import TypeVar

T = TypeVar("T")
Told = TypeVar("Told")
Other = TypeVar("Other")


def run_steps(steps: Generator[Told, None, T], each: Callable[[Told], object] = lambda told: None) -> T:
    """Run steps to their end, call ``each`` with what every one yields, and return what they return."""
    while True:
        try:
            told = next(steps)
        except StopIteration as stop:
            return stop.value
        each(told)


def told_as(steps: Generator[Told, None, T], tell: Callable[[Told], Other]) -> Generator[Other, None, T]:
    """Yield for each step ``tell`` of what it yields, and return what the steps return."""
    while True:
        try:
            told = next(steps)
        except StopIteration as stop:
            return stop.value
        yield tell(told)


def here(function: Callable[[], T]) -> Generator[None, None, T]:
    """Yield once, and return what a function returns: the step for callers that have no thread to run it in."""
    yield
    return function()
