"""Work as generators that yield before each piece, for callers that must not block; the available cores."""

from __future__ import annotations

import functools
import inspect
import os
from collections.abc import Callable, Generator
from typing import Any, ParamSpec, TypeVar, get_args

P = ParamSpec("P")
T = TypeVar("T")
Step = TypeVar("Step")
Other = TypeVar("Other")


def run_steps(steps: Generator[Step, None, T], each: Callable[[Step], object] = lambda step: None) -> T:
    """Run steps to the end, call ``each`` with every yielded value, and return their result."""
    while True:
        try:
            step = next(steps)
        except StopIteration as stop:
            return stop.value
        each(step)


def blocking(name: str, steps: Callable[P, Generator[Any, None, T]]) -> Callable[P, T]:
    """Return the function ``name`` that takes the arguments of ``steps``, runs them all and returns their result."""

    @functools.wraps(steps)
    def run(*args: P.args, **kwargs: P.kwargs) -> T:
        return run_steps(steps(*args, **kwargs))

    run.__name__ = run.__qualname__ = name
    signature = inspect.signature(steps)
    result = _result_annotation(signature.return_annotation)
    run.__annotations__ = {**steps.__annotations__, "return": result}
    run.__signature__ = signature.replace(return_annotation=result)  # type: ignore[attr-defined]
    return run


def _result_annotation(steps: Any) -> Any:
    """Return the type of a generator's result, for help(); an annotation may be a text."""
    if isinstance(steps, str):
        return steps.split(", ", 2)[-1].removesuffix("]")
    return (get_args(steps) or (steps,))[-1]


def map_steps(steps: Generator[Step, None, T], function: Callable[[Step], Other]) -> Generator[Other, None, T]:
    """Yield ``function`` of every yielded value; return the steps' result."""
    while True:
        try:
            step = next(steps)
        except StopIteration as stop:
            return stop.value
        yield function(step)


def one_step(function: Callable[[], T]) -> Generator[None, None, T]:
    """Yield once, then return a function's result: for callers without a thread."""
    yield
    return function()


def available_cores() -> set[int]:
    """Return the processor's cores on which this process may run."""
    if hasattr(os, "sched_getaffinity"):
        return os.sched_getaffinity(0)
    return set(range(os.cpu_count() or 1))
