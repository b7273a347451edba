"""The built zip, installed into a Blender that has nothing else, by a process that never saw this repository."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
SCRIPTS = ROOT / "scripts"

pytestmark = pytest.mark.bpy_only

sys.path.insert(0, str(SCRIPTS))
install_extension = pytest.importorskip("install_extension")


def installed(package: Path) -> dict:
    """Install a zip in the bpy wheel that runs this; return what was found."""
    command = [sys.executable, SCRIPTS / "install_extension.py", package, "--json", "--wheel"]
    result = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert result.returncode == 0, result.stdout + result.stderr
    return json.loads(result.stdout)


@pytest.fixture(scope="module")
def package(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("install")
    build = [sys.executable, SCRIPTS / "extension.py", folder, "--without-wheels"]
    return Path(subprocess.run(build, capture_output=True, text=True, check=True).stdout.strip())


@pytest.fixture(scope="module")
def facts(package) -> dict:
    return installed(package)


def test_blender_installs_and_enables_the_zip(facts):
    assert (facts["done"], facts["enabled"]) == (["FINISHED"], ["bl_ext.user_default.irpso"])


def test_enabling_adds_one_command_and_disabling_takes_it_away(facts):
    assert (facts["commands"], facts["commands after"]) == (["irpso"], [])


def test_enabling_adds_the_interface_and_disabling_takes_it_away(facts):
    assert "Settings" in facts["classes"]
    assert facts["classes after"] == []


def test_the_installed_program_knows_its_own_package(facts):
    assert facts["base"] == "bl_ext.user_default.irpso"


def test_the_installed_program_finds_its_own_shaders_and_presets(facts):
    assert (facts["model"], facts["schedule"]) == ("lambert", "standard")
    assert facts["root"].startswith(facts["profile"])


def test_every_module_of_the_program_can_be_imported_from_where_it_is_installed(facts):
    shipped = [path for path in (ROOT / "irpso_addon").rglob("*.py") if path.name != "__init__.py"]
    packages = [path for path in (ROOT / "irpso_addon").rglob("__init__.py")]
    assert facts["modules"] == len(shipped) - 1 + len(packages) - 1  # without __main__ and the package itself


def test_blender_has_nothing_to_warn_of(facts):
    assert facts["violations"] == []


def test_the_program_writes_nothing_into_its_own_folder(facts):
    assert facts["written"] == []


def test_a_zip_without_wheels_brings_no_libraries(facts):
    assert facts["exr"] is facts["pillow"] is None and facts["optional"] == {}


def test_a_faulty_installation_is_reported(facts):
    assert install_extension.faults(facts, with_wheels=False) == []
    broken = facts | {"classes after": ["Settings"], "commands": []}
    assert install_extension.faults(broken, with_wheels=True) == [
        "the command irpso was not registered",
        "classes outlived the extension: ['Settings']",
        "OpenEXR is not that of the zip but None",
        "Pillow is not that of the zip but None",
        "OpenEXR gave back other numbers than it got",
        "Pillow drew no text",
        "rawpy is not that of the zip but nowhere",
        "rawpy does not work",
        "pillow_heif is not that of the zip but nowhere",
        "pillow_heif does not work",
        "cv2 is not that of the zip but nowhere",
        "cv2 does not work",
    ]


def test_a_zip_with_wheels_brings_the_libraries_that_the_program_uses(tmp_path):
    extension, wheels = install_extension.extension, install_extension.extension.wheels
    system = extension.this_platform()
    needed = [wheels.requirement(library, system) for library in (*wheels.LIBRARIES, *wheels.OPTIONAL)]
    if not all((extension.CACHE / name).is_dir() for name in needed):
        pytest.skip("the wheels are not on this machine; `make extension` downloads them")
    package, pythons = extension.build_all(tmp_path, [system])[system]
    facts = installed(package)
    assert facts["python"] in pythons
    assert install_extension.faults(facts, with_wheels=True) == []
