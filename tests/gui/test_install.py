"""The built zip, installed into a real Blender as the README says, in a window and from the command line."""

import json

MODULE = "bl_ext.user_default.irpso"


def test_the_installed_extension_is_enabled_in_the_window(window):
    assert window.run(f"{MODULE!r} in bpy.context.preferences.addons")
    assert window.run(f"import sys; sys.modules[{MODULE!r}].irpso_addon.__file__").startswith(str(window.folder))
    window.screenshot("installed")


def test_the_window_has_the_backend_that_was_asked_for(window, backend):
    facts = window.run(f"import importlib\nimportlib.import_module('{MODULE}.irpso_addon.gpu.context').describe()")
    assert facts["backend"] == backend.upper()
    assert facts["renderer"] == window.run("__import__('gpu').platform.renderer_get()") != ""


def test_doctor_finds_the_gpu_from_the_command_line_of_the_same_blender(blender, settings, tmp_path):
    variables = {"BLENDER_USER_RESOURCES": str(settings), "TMPDIR": str(tmp_path)}
    command = ["--background", "--command", "irpso", "doctor", "--json"]
    done = blender.run(blender.executable, *command, variables=variables)
    facts = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    assert (done.returncode, len(facts)) == (0, 1), done.stdout
    assert facts[0]["entry"] in ("fragment", "compute")
