"""What some versions of Blender can and others cannot, asked by feature, for all of the user interface."""

import bpy

# Since 4.5 Blender warns of a path that begins with "//" in a property that does not say it may.
_MAY_BE_RELATIVE = "is_path_supports_blend_relative" in bpy.types.Property.bl_rna.properties
RELATIVE_PATH = {"options": {"PATH_SUPPORTS_BLEND_RELATIVE"}} if _MAY_BE_RELATIVE else {}  # for StringProperty
