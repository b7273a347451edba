"""Tests for features of Blender that some versions lack. They ask for the feature, not for the version."""

import bpy

# Since 4.5 Blender warns of a path that begins with "//" unless the property has this option.
_MAY_BE_RELATIVE = "is_path_supports_blend_relative" in bpy.types.Property.bl_rna.properties
RELATIVE_PATH = {"options": {"PATH_SUPPORTS_BLEND_RELATIVE"}} if _MAY_BE_RELATIVE else {}  # for StringProperty
