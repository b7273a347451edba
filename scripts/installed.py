"""Run inside Blender, after ``--``: installs and enables a zip, tries what came with it, disables it, tells in JSON.

Usage: blender --background --python scripts/installed.py -- ZIP, or with Blender as a module: python … -- ZIP
The line begins with TOLD. The program never sees this repository: what works here works for whoever has the zip only.
"""

import importlib
import json
import os
import pkgutil
import sys
import tempfile
import traceback
from pathlib import Path

import bpy

# What an extension may register a class of.
BASES = ("AddonPreferences", "FileHandler", "Header", "Menu", "Operator", "Panel", "PropertyGroup", "UIList")


def watch_commands() -> list[str]:
    """Return a list that will hold the names of the command line commands that are registered, as they come and go."""
    names, handles = [], {}
    register, unregister = bpy.utils.register_cli_command, bpy.utils.unregister_cli_command

    def come(name, function):
        handle = register(name, function)
        handles[id(handle)] = name
        names.append(name)
        return handle

    def go(handle):
        unregister(handle)
        names.remove(handles.pop(id(handle)))

    bpy.utils.register_cli_command, bpy.utils.unregister_cli_command = come, go
    return names


def classes() -> list[str]:
    """Return the names of the program's classes that Blender knows now, in order."""
    bases = [getattr(bpy.types, name) for name in BASES]
    kinds = [kind for base in bases for kind in base.__subclasses__() if ".irpso." in kind.__module__]
    return sorted(kind.__name__ for kind in kinds if kind.is_registered)


def import_all(package: str) -> int:
    """Import every module of the program but the one that starts it from a shell; return how many there are."""
    folders = sys.modules[package].__path__
    names = [module.name for module in pkgutil.walk_packages(folders, f"{package}.")]
    names = [name for name in names if not name.endswith(".__main__")]
    for name in names:
        importlib.import_module(name)
    return len(names)


def violations(extension: str) -> list[str]:
    """Return what Blender would warn of in its list of extensions: modules outside its own package, and paths."""
    look = importlib.import_module("addon_utils")._extensions_warnings_get
    look._is_first = True  # it looks once, then answers the same
    return look().get(extension, [])


def files(folder: Path) -> list[str]:
    """Return the files in a folder, but those of Python's own cache."""
    paths = [path for path in folder.rglob("*") if path.is_file() and "__pycache__" not in path.parts]
    return sorted(path.relative_to(folder).as_posix() for path in paths)


def exr_round_trip(package: str) -> dict:
    """Write a small file through the program, read it with OpenEXR; return where OpenEXR lies and what came back.

    "exr" is None where the zip brought no OpenEXR and Blender has none.
    """
    try:
        import OpenEXR
    except ModuleNotFoundError:
        return {"exr": None}
    import numpy as np

    sent = np.arange(12, dtype=np.float32).reshape(3, 4) / 7
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "a.exr")
        importlib.import_module(f"{package}.capture.images.exr").write_exr(path, {"image": {"Y": sent}})
        with OpenEXR.File(path, separate_channels=True) as file:
            came = file.channels()["Y"].pixels[::-1]  # files have the top row first
    return {"exr": OpenEXR.__file__, "exr version": OpenEXR.__version__, "exr same": bool((came == sent).all())}


def picture(package: str) -> dict:
    """Draw through the program; return where Pillow lies and whether there is text. "pillow" is None without it."""
    try:
        import PIL
    except ModuleNotFoundError:
        return {"pillow": None}
    canvas = importlib.import_module(f"{package}.core.canvas").Canvas(60, 20, (0, 0, 0))
    canvas.text(2, 15, "text", 10)
    return {"pillow": PIL.__file__, "pillow version": PIL.__version__, "drawn": bool(canvas.result().max() > 0.5)}


def optional(package: str) -> dict[str, list]:
    """Use the optional libraries; return module → [where it lies, its version, whether it works] of those there are."""
    import io

    import numpy as np

    def developed(rawpy) -> bool:
        try:
            rawpy.imread(io.BytesIO(b"no raw file"))
        except rawpy.LibRawError:
            return True
        return False

    def photographed(pillow_heif) -> bool:
        file = io.BytesIO()
        pillow_heif.from_bytes("RGB", (64, 64), bytes(64 * 64 * 3)).save(file)
        heif = importlib.import_module(f"{package}.capture.images.heif")
        return heif.decode_heif(Path("a.heic"), file.getvalue()).values.shape == (64, 64, 3)

    def drawn(cv2) -> bool:
        markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
        sheet = cv2.copyMakeBorder(
            cv2.aruco.generateImageMarker(markers, 3, 60), *[30] * 4, cv2.BORDER_CONSTANT, None, 255
        )
        found = cv2.aruco.ArucoDetector(markers).detectMarkers(sheet)[1]
        return np.ravel(found).tolist() == [3]

    told = {}
    for name, works in (("rawpy", developed), ("pillow_heif", photographed), ("cv2", drawn)):
        try:
            module = importlib.import_module(name)
        except ModuleNotFoundError:
            continue
        told[name] = [module.__file__, module.__version__, works(module)]
    return told


def try_zip(path: str) -> dict:
    """Install, enable, try and disable a zip; return what was found at each."""
    commands = watch_commands()
    done = bpy.ops.extensions.package_install_files(filepath=path, repo="user_default", enable_on_install=True)
    enabled = [addon.module for addon in bpy.context.preferences.addons if addon.module.endswith(".irpso")]
    if not enabled:
        raise RuntimeError("Blender did not enable the extension; see its output")
    name = f"{enabled[0]}.irpso_addon"
    package, paths = importlib.import_module(name), importlib.import_module(f"{name}.core.paths")
    brought = files(paths.ROOT)
    told = {
        "blender": bpy.app.version_string,
        "python": "{}.{}".format(*sys.version_info),
        "done": list(done),
        "enabled": enabled,
        "commands": list(commands),
        "classes": classes(),
        "modules": import_all(name),
        "base": paths.BASE_PACKAGE,
        "root": str(paths.ROOT),
        "model": package.load_model("lambert").name,
        "schedule": package.load_schedule("standard").name,
    }
    told |= exr_round_trip(name) | picture(name) | {"optional": optional(name)}
    told |= {"violations": violations(enabled[0]), "written": sorted({*files(paths.ROOT)} ^ {*brought})}
    bpy.ops.preferences.addon_disable(module=enabled[0])
    return told | {"commands after": list(commands), "classes after": classes()}


def main() -> int:
    """Try the zip named on the command line; return 1 where it failed, with the traceback on stderr."""
    try:
        told = try_zip(os.path.abspath(sys.argv[sys.argv.index("--") + 1]))
    except Exception:  # noqa: BLE001 Blender goes on after a script's error and ends with 0
        traceback.print_exc()
        return 1
    print("TOLD", json.dumps(told), flush=True)
    return 0


code = main()
sys.stdout.flush()
sys.stderr.flush()
os._exit(code)  # bpy 4.5 does not end by itself
