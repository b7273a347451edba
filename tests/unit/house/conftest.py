"""What the house tests share: the extension's zip without wheels, built once."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="session")
def package(tmp_path_factory) -> Path:
    """The path of the zip, which Blender's own tool has built and validated."""
    if importlib.util.find_spec("bpy") is None:
        pytest.skip("Blender's extension tool comes with the bpy wheel, which is absent")
    folder = tmp_path_factory.mktemp("package")
    command = [sys.executable, ROOT / "scripts" / "extension.py", folder, "--without-wheels"]
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == 0, result.stdout + result.stderr
    return Path(result.stdout.strip())
