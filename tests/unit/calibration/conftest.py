"""Fixtures of the tests of ``develop`` and ``response``."""

import pytest

from irpso_addon.commands import develop, response
from tests.builders.captures import decode_png
from tests.builders.exposures import write_photographs


@pytest.fixture
def png_without_blender(monkeypatch):
    """PNG files are read without Blender."""
    monkeypatch.setattr(develop, "decode", decode_png)
    monkeypatch.setattr(response, "decode", decode_png)


@pytest.fixture
def photographs(tmp_path):
    """The folder of ``write_photographs``."""
    return write_photographs(tmp_path / "capture")
