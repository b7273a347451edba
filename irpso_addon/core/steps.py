"""Work in steps: a generator that yields before each piece, for callers that must not wait."""

from __future__ import annotations

import functools
from collections.abc import Callable, Generator
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")
Step = TypeVar("Step")
Other = TypeVar("Other")


def run_steps(steps: Generator[Step, None, T], each: Callable[[Step], object] = lambda step: None) -> T:
    """Run steps to their end, call ``each`` with what every one yields, and return what they return."""
    while True:
        try:
            step = next(steps)
        except StopIteration as stop:
            return stop.value
        each(step)


def at_once(name: str, steps: Callable[P, Generator[Any, None, T]]) -> Callable[P, T]:
    """Return the function ``name`` that takes the arguments of ``steps``, makes them all and returns their result."""

    @functools.wraps(steps)
    def run(*args: P.args, **kwargs: P.kwargs) -> T:
        return run_steps(steps(*args, **kwargs))

    run.__name__ = run.__qualname__ = name
    return run


def map_steps(steps: Generator[Step, None, T], function: Callable[[Step], Other]) -> Generator[Other, None, T]:
    """Yield for each step ``function`` of what it yields, and return what the steps return."""
    while True:
        try:
            step = next(steps)
        except StopIteration as stop:
            return stop.value
        yield function(step)


def one_step(function: Callable[[], T]) -> Generator[None, None, T]:
    """Yield once, and return what a function returns: the step for callers that have no thread to run it in."""
    yield
    return function()
