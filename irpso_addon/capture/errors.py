"""What can be wrong with a capture: the exception its readers raise."""

from __future__ import annotations

from ..core.errors import InputError


class CaptureError(InputError):
    """A capture that cannot be used.

    code: a short name of the kind of fault, for inspect and for tests. others: further faults found at the same time.
    """

    def __init__(self, message: str, code: str = "unreadable", others: tuple[CaptureError, ...] = ()):
        more = f" (and {len(others)} more like it: see 'inspect')" if others else ""
        super().__init__(message + more)
        self.code = code
        self.message = message
        self.others = others

    @property
    def all(self) -> tuple[CaptureError, ...]:
        """This fault and those found with it."""
        return (self, *self.others)


def raise_all(faults: list[CaptureError]) -> None:
    """Raise the first of ``faults``, carrying the rest; do nothing where there are none."""
    if faults:
        first = faults[0]
        raise CaptureError(first.message, first.code, (*first.others, *faults[1:]))
