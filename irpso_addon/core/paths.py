"""Paths of the program's own data, and the package's name as an extension."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SHADERS = ROOT / "shaders"
MODELS = SHADERS / "models"
PRESETS = ROOT / "presets"
PAGE = ROOT / "web"  # the files of the web page that an export writes
DEFAULT_MODEL = "metallic_roughness"  # in MODELS

# Installed as an extension this module is bl_ext.REPOSITORY.irpso.irpso_addon.core.paths; Blender's own functions
# (preferences, extension_path_user) want the part before irpso_addon.
_PACKAGE = __package__.removesuffix(".core")
BASE_PACKAGE = _PACKAGE.rpartition(".")[0] or _PACKAGE
