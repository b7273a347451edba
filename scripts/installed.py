"""Runs inside Blender: installs and enables a zip, tests its program and libraries, disables it, prints JSON.

Usage: blender --background --python scripts/installed.py -- ZIP, or with Blender as a module: python … -- ZIP
The line begins with TOLD. The installed program does not see this repository, only the zip's files.
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

# Base classes of an extension's registered classes.
BASES = ("AddonPreferences", "FileHandler", "Header", "Menu", "Operator", "Panel", "PropertyGroup", "UIList")


def watch_commands() -> list[str]:
    """Return a list of the registered command line commands' names, which stays up to date."""
    names, handles = [], {}
    register, unregister = bpy.utils.register_cli_command, bpy.utils.unregister_cli_command

    def register_and_note(name, function):
        handle = register(name, function)
        handles[id(handle)] = name
        names.append(name)
        return handle

    def unregister_and_note(handle):
        unregister(handle)
        names.remove(handles.pop(id(handle)))

    bpy.utils.register_cli_command, bpy.utils.unregister_cli_command = register_and_note, unregister_and_note
    return names


def classes() -> list[str]:
    """Return the sorted names of the program's registered classes."""
    bases = [getattr(bpy.types, name) for name in BASES]
    kinds = [kind for base in bases for kind in base.__subclasses__() if ".irpso." in kind.__module__]
    return sorted(kind.__name__ for kind in kinds if kind.is_registered)


def import_all(package: str) -> int:
    """Import every module of the program except __main__; return their number."""
    folders = sys.modules[package].__path__
    names = [module.name for module in pkgutil.walk_packages(folders, f"{package}.")]
    names = [name for name in names if not name.endswith(".__main__")]
    for name in names:
        importlib.import_module(name)
    return len(names)


def violations(extension: str) -> list[str]:
    """Return Blender's warnings in its list of extensions: modules outside the package, and paths."""
    warnings_of = importlib.import_module("addon_utils")._extensions_warnings_get
    warnings_of._is_first = True  # else it returns its cached answer
    return warnings_of().get(extension, [])


def files(folder: Path) -> list[str]:
    """Return the files in a folder, without Python's caches."""
    paths = [path for path in folder.rglob("*") if path.is_file() and "__pycache__" not in path.parts]
    return sorted(path.relative_to(folder).as_posix() for path in paths)


def exr_round_trip(package: str) -> dict:
    """Write a small file by the program, read it by OpenEXR; return OpenEXR's path, version, and whether it is equal.

    "exr" is None if neither the zip nor Blender has OpenEXR.
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
            received = file.channels()["Y"].pixels[::-1]  # files have the top row first
    return {"exr": OpenEXR.__file__, "exr version": OpenEXR.__version__, "exr same": bool((received == sent).all())}


def picture(package: str) -> dict:
    """Draw text by the program; return Pillow's path, version, and whether it is visible. "pillow": None without it."""
    try:
        import PIL
    except ModuleNotFoundError:
        return {"pillow": None}
    canvas = importlib.import_module(f"{package}.core.canvas").Canvas(60, 20, (0, 0, 0))
    canvas.text(2, 15, "text", 10)
    return {"pillow": PIL.__file__, "pillow version": PIL.__version__, "drawn": bool(canvas.result().max() > 0.5)}


def optional(package: str) -> dict[str, list]:
    """Use the available optional libraries; return module → [path, version, whether it works]."""
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
        numbers = cv2.aruco.ArucoDetector(markers).detectMarkers(sheet)[1]
        return np.ravel(numbers).tolist() == [3]

    results = {}
    for name, works in (("rawpy", developed), ("pillow_heif", photographed), ("cv2", drawn)):
        try:
            module = importlib.import_module(name)
        except ModuleNotFoundError:
            continue
        results[name] = [module.__file__, module.__version__, works(module)]
    return results


def try_zip(path: str) -> dict:
    """Install, enable, test and disable a zip; return the report."""
    commands = watch_commands()
    done = bpy.ops.extensions.package_install_files(filepath=path, repo="user_default", enable_on_install=True)
    enabled = [addon.module for addon in bpy.context.preferences.addons if addon.module.endswith(".irpso")]
    if not enabled:
        raise RuntimeError("Blender did not enable the extension; see its output")
    name = f"{enabled[0]}.irpso_addon"
    package, paths = importlib.import_module(name), importlib.import_module(f"{name}.core.paths")
    packed = files(paths.ROOT)
    report = {
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
    report |= exr_round_trip(name) | picture(name) | {"optional": optional(name)}
    report |= {"violations": violations(enabled[0]), "written": sorted({*files(paths.ROOT)} ^ {*packed})}
    bpy.ops.preferences.addon_disable(module=enabled[0])
    return report | {"commands after": list(commands), "classes after": classes()}


def main() -> int:
    """Test the zip of the command line; return 1 if it fails, with the traceback on stderr."""
    try:
        report = try_zip(os.path.abspath(sys.argv[sys.argv.index("--") + 1]))
    except Exception:  # noqa: BLE001 Blender goes on after a script's error and ends with 0
        traceback.print_exc()
        return 1
    print("TOLD", json.dumps(report), flush=True)
    return 0


code = main()
sys.stdout.flush()
sys.stderr.flush()
os._exit(code)  # bpy 4.5 does not end by itself
