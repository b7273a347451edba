"""Ctrl-C, put off until what is under way is whole."""

import signal

import pytest

from irpso_addon.core import interrupt
from irpso_addon.core.errors import GpuUnavailableError, InputError


@pytest.fixture(autouse=True)
def handlers_put_back():
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (KeyboardInterrupt(), 130),
        (MemoryError(), 2),
        (InputError("x"), 2),
        (GpuUnavailableError("x"), 3),
        (OSError(), 1),
    ],
)
def test_every_error_has_its_exit_code(error, code):
    assert interrupt.exit_code_of(error) == code


def test_the_first_signal_is_only_noted():
    with interrupt.delayed_signals() as interrupted:
        assert not interrupted()
        signal.raise_signal(signal.SIGINT)
        assert interrupted()


def test_the_second_signal_interrupts_at_once():
    with pytest.raises(KeyboardInterrupt), interrupt.delayed_signals():
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGTERM)


def test_the_former_handlers_are_back_afterwards():
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    with interrupt.delayed_signals():
        pass
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


def test_blenders_signal_handler_is_replaced_by_pythons(monkeypatch):
    real = signal.signal

    def from_outside(number, handler):
        former = real(number, handler)
        return None if handler.__name__ == "note" else former  # what Python says of a handler set from C

    monkeypatch.setattr(interrupt.signal, "signal", from_outside)
    with interrupt.delayed_signals():
        pass
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
