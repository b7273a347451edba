"""Functions that run a generator to its end."""

import inspect

import irpso_addon
from irpso_addon.core.steps import blocking


def counted(most: int) -> "Generator[float, None, tuple[int, str]]":  # noqa: F821
    """Count."""
    yield 0.5
    return most, "done"


def test_the_signature_shows_what_is_returned():
    run = blocking("count", counted)
    assert run(3) == (3, "done")
    assert str(inspect.signature(run).return_annotation) == "tuple[int, str]" == run.__annotations__["return"]
    assert list(inspect.signature(run).parameters) == ["most"]
    assert inspect.signature(irpso_addon.domain_from_card).return_annotation == "Domain"
    assert inspect.signature(irpso_addon.estimate_lights).return_annotation == "Lights"
