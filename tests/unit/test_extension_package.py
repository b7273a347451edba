"""The zip that Blender installs: what is in it, what is not, and that Blender's own tool accepts it."""

import importlib.util
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent.parent

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("bpy") is None, reason="Blender's extension tool comes with the bpy wheel, which is absent"
)


@pytest.fixture(scope="module")
def package(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("package")
    command = [sys.executable, ROOT / "scripts" / "extension.py", folder, "--without-wheels"]
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == 0, result.stdout + result.stderr
    return Path(result.stdout.strip())


@pytest.fixture(scope="module")
def names(package) -> set[str]:
    with zipfile.ZipFile(package) as archive:
        return {name for name in archive.namelist() if not name.endswith("/")}


def files_below(*folders: str) -> set[str]:
    """Return the source files below some folders of the repository, as names in a zip."""
    paths = [path for folder in folders for path in (ROOT / folder).rglob("*") if path.is_file()]
    return {path.relative_to(ROOT).as_posix() for path in paths if "__pycache__" not in path.parts}


def test_the_zip_is_named_after_the_manifest(package):
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    assert package.name == f"{manifest['id']}-{manifest['version']}.zip"


def test_the_zip_holds_the_whole_program(names):
    wanted = files_below("irpso_addon", "shaders", "presets") | {"__init__.py", "blender_manifest.toml", "LICENSE"}
    assert wanted - names == set()


def test_the_zip_holds_nothing_else(names):
    allowed = files_below("irpso_addon", "shaders", "presets")
    assert names - allowed <= {"__init__.py", "blender_manifest.toml", "LICENSE", "README.md"}


def test_an_unreadable_manifest_is_refused(tmp_path):
    text = (ROOT / "blender_manifest.toml").read_text(encoding="utf-8")
    (tmp_path / "blender_manifest.toml").write_text(text.replace('id = "irpso"', 'id = "ir pso"'), encoding="utf-8")
    (tmp_path / "__init__.py").touch()
    probe = "import sys, extension; extension.blender_extension('validate', sys.argv[1])"
    command = [sys.executable, "-c", probe, tmp_path]
    result = subprocess.run(command, cwd=ROOT / "scripts", capture_output=True, text=True)
    assert result.returncode == 1
    assert 'key "id" invalid' in result.stderr
