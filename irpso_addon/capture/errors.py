"""The exception of capture readers."""

from __future__ import annotations

from ..core.errors import InputError


class CaptureError(InputError):
    """An unusable capture. code: short name of the kind of fault. others: further faults of the same capture."""

    def __init__(self, message: str, code: str = "unreadable", others: tuple[CaptureError, ...] = ()):
        more = f" (and {len(others)} more like it: see 'inspect')" if others else ""
        super().__init__(message + more)
        self.code = code
        self.message = message
        self.others = others

    @property
    def all(self) -> tuple[CaptureError, ...]:
        """This fault and ``others``."""
        return (self, *self.others)


def raise_all(faults: list[CaptureError]) -> None:
    """Raise the first of ``faults``, with the rest in ``others``; do nothing for none."""
    if faults:
        first = faults[0]
        raise CaptureError(first.message, first.code, (*first.others, *faults[1:]))
