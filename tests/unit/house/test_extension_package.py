"""The zip that Blender installs: what is in it, what is not, and that Blender's own tool accepts it."""

import importlib
import importlib.util
import itertools
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "scripts"))

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("bpy") is None, reason="Blender's extension tool comes with the bpy wheel, which is absent"
)


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
    wanted = files_below("irpso_addon", "shaders", "presets", "web") | {
        "__init__.py",
        "blender_manifest.toml",
        "LICENSE",
    }
    assert wanted - names == set()


def test_the_zip_holds_nothing_else(names):
    allowed = files_below("irpso_addon", "shaders", "presets", "web")
    assert names - allowed <= {"__init__.py", "blender_manifest.toml", "LICENSE", "README.md"}


def test_a_stray_file_stays_out(names):
    lying = {path.name for path in ROOT.iterdir()} - {"irpso_addon", "presets", "shaders", "web"}
    assert {name.split("/")[0] for name in names} & lying <= {
        "__init__.py",
        "blender_manifest.toml",
        "LICENSE",
        "README.md",
    }


def test_the_same_sources_give_the_same_bytes(package, tmp_path):
    # Copies made in another order, at another time: neither may show.
    source = tmp_path / "source"
    source.mkdir()
    for name in ("LICENSE", "README.md", "__init__.py", "blender_manifest.toml"):
        shutil.copyfile(ROOT / name, source / name)
    for name in ("shaders", "presets", "web", "irpso_addon", "scripts"):
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / name, source / name, copy_function=shutil.copyfile, ignore=ignored)
    command = [sys.executable, source / "scripts" / "extension.py", tmp_path / "dist", "--without-wheels"]
    again = Path(subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip())
    assert again.read_bytes() == package.read_bytes()


ABSENT = {("Pillow", "macos-x64", "3.14"), ("rawpy", "macos-x64", "3.13")}


@pytest.fixture
def wheels(tmp_path, monkeypatch):
    """Wheels with libraries of a few bytes for every system and Python but ABSENT, and pip out of reach."""
    extension = importlib.import_module("extension")
    cache = tmp_path / "cache"
    monkeypatch.setattr(extension, "CACHE", cache)
    parts = extension.wheels
    libraries = (*parts.LIBRARIES, *parts.OPTIONAL)
    for library, system, python in itertools.product(libraries, parts.PLATFORMS, parts.PYTHONS):
        folder = cache / parts.requirement(library, system) / f"{system}-{python}"
        folder.mkdir(parents=True)
        tag = f"cp{python.replace('.', '')}"
        tags = "cp37-abi3" if library.startswith("opencv") else f"{tag}-{tag}"
        stable_again = library.startswith("opencv") and python != parts.PYTHONS[0]
        if (library, system, python) not in ABSENT and not stable_again:
            name = f"{library.lower().replace('-', '_')}-1-{tags}-{parts.PLATFORMS[system][-1]}.whl"
            (folder / name).write_bytes(f"a wheel of {library}".encode())
    monkeypatch.setattr(parts, "isolate", lambda wheel, library: wheel.write_bytes(f"{library} isolated".encode()))
    none = subprocess.CompletedProcess([], 1, "", "ERROR: No matching distribution found for Pillow")
    run = subprocess.run
    pip = lambda command, **options: none if "download" in command else run(command, **options)  # noqa: E731
    monkeypatch.setattr(extension.wheels.subprocess, "run", pip)
    return extension


def test_every_system_has_a_zip_with_its_own_wheels_alone(wheels, tmp_path):
    built = wheels.build_all(tmp_path / "dist")
    version = wheels.manifest()["version"]
    assert {system: package.name for system, (package, _) in built.items()} == {
        "linux-x64": f"irpso-{version}-linux_x64.zip",
        "windows-x64": f"irpso-{version}-windows_x64.zip",
        "macos-arm64": f"irpso-{version}-macos_arm64.zip",
        "macos-x64": f"irpso-{version}-macos_x64.zip",
    }
    words = {"linux-x64": "manylinux", "windows-x64": "win_amd64", "macos-arm64": "_arm64", "macos-x64": "macosx"}
    for system, (package, pythons) in built.items():
        with zipfile.ZipFile(package) as archive:
            held = [name for name in archive.namelist() if name.startswith("wheels/")]
            added = tomllib.loads(archive.read("blender_manifest.toml").decode())["build"]["generated"]
            contents = {archive.read(name).decode() for name in held}
        for library in ("openexr", "pillow"):
            own = [name.split("-")[2] for name in held if name.startswith(f"wheels/{library}-")]
            assert own == [f"cp{python.replace('.', '')}" for python in pythons]
        assert all(words[system] in name for name in held)
        assert added == {"platforms": [system], "wheels": [f"./{name}" for name in held]}
        isolated = ("OpenEXR", "pillow-heif", "rawpy") if system == "linux-x64" else ()
        every = (*wheels.wheels.LIBRARIES, *wheels.wheels.OPTIONAL)
        assert contents == {f"{name} isolated" if name in isolated else f"a wheel of {name}" for name in every}


def test_an_optional_library_without_a_wheel_costs_no_python(wheels, tmp_path):
    package, pythons = wheels.build_all(tmp_path / "dist", ["macos-x64"])["macos-x64"]
    assert pythons == ["3.11", "3.13"]
    with zipfile.ZipFile(package) as archive:
        names = [name for name in archive.namelist() if name.endswith(".whl")]
    assert len([name for name in names if "rawpy" in name]) == 1
    version = wheels.wheels.VERSIONS["rawpy", "macos-x64"]
    assert f"rawpy=={version}, Python 3.11" in wheels.optional_lines(package, "macos-x64", pythons)


def test_a_wheel_of_the_stable_abi_is_packed_once_for_all_pythons(wheels, tmp_path):
    package, pythons = wheels.build_all(tmp_path / "dist", ["linux-x64"])["linux-x64"]
    with zipfile.ZipFile(package) as archive:
        (name,) = [name for name in archive.namelist() if name.startswith("wheels/opencv")]
    assert "-cp311-abi3-manylinux" in name
    held = wheels.wheels.requirement("opencv-python-headless")
    assert f"{held}, Python 3.11, 3.13, 3.14" in wheels.optional_lines(package, "linux-x64", pythons)


def test_a_missing_wheel_is_reported(wheels, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["extension.py", str(tmp_path / "dist")])
    wheels.main()
    lines = capsys.readouterr().out.splitlines()
    held = ", ".join(map(wheels.wheels.requirement, wheels.wheels.LIBRARIES))
    assert lines[-1] == f"no wheels of {held} exist for macos-x64 with Python 3.14"
    assert len([line for line in lines if not line.startswith("  ")]) == 5


def test_a_network_that_is_down_is_not_taken_for_a_missing_wheel(wheels, tmp_path, monkeypatch):
    said = "WARNING: Retrying (Retry(total=4)) after connection broken\nERROR: No matching distribution found"
    failed = subprocess.CompletedProcess([], 1, "", said)
    monkeypatch.setattr(wheels.wheels.subprocess, "run", lambda *_, **__: failed)
    with pytest.raises(SystemExit, match="connection broken"):
        wheels.wheels.download("Pillow", "linux-x64", "3.11", tmp_path / "empty")


def test_an_unreadable_manifest_is_refused(tmp_path):
    text = (ROOT / "blender_manifest.toml").read_text(encoding="utf-8")
    (tmp_path / "blender_manifest.toml").write_text(text.replace('id = "irpso"', 'id = "ir pso"'), encoding="utf-8")
    (tmp_path / "__init__.py").touch()
    probe = "import sys, extension; extension.blender_extension('validate', sys.argv[1])"
    command = [sys.executable, "-c", probe, tmp_path]
    result = subprocess.run(command, cwd=ROOT / "scripts", capture_output=True, text=True)
    assert result.returncode == 1
    assert 'key "id" invalid' in result.stderr
