"""Saves the kept material of an object into one of the user's asset libraries."""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy.props import EnumProperty, StringProperty

from ...blender.materials.asset import recovered_slot
from ...blender.materials.material import TAG
from ...core.errors import InputError
from ...exports.asset import Shelf, write_to_shelf
from ..common import failures
from ..common.polls import usable
from ..common.words import rpt

_NO_LIBRARY = "no asset library: add one in Preferences › File Paths › Asset Libraries"
_items: list[tuple[str, str, str]] = []  # of the menu: kept here because Blender holds no reference


def _libraries(_operator, context) -> list[tuple[str, str, str]]:
    """Return the user's asset libraries as menu items."""
    _items[:] = [(one.name, one.name, one.path) for one in context.preferences.filepaths.asset_libraries]
    return _items


def has_recovered_material(obj) -> bool:
    """Return whether an object has a material of IRPSO in one of its slots."""
    return obj is not None and any(slot.material is not None and TAG in slot.material for slot in obj.material_slots)


class IRPSO_OT_save_asset(bpy.types.Operator):
    """Save the recovered material of the active object into an asset library, with its maps and a preview"""

    bl_idname = "irpso.save_asset"
    bl_label = "Save to Asset Library"
    bl_options = {"REGISTER"}

    library: EnumProperty(name="Library", description="One of your asset libraries", items=_libraries)
    asset_name: StringProperty(name="Name", description="The asset's name, and that of its file in the library")
    catalog: StringProperty(
        name="Catalog", description="Catalog in the library, as in Tiles/Glazed. Created if it does not exist. Optional"
    )
    author: StringProperty(name="Author", description="Who photographed it. Optional")
    license: StringProperty(name="License", description="For example CC-BY-4.0. Optional")
    tags: StringProperty(name="Tags", description="Words to find it by, separated by commas. Optional")

    @classmethod
    def poll(cls, context) -> bool:
        """Whether the active object has a recovered material."""
        there = has_recovered_material(context.object)
        return usable(cls, there, "Keep a material first, and make its object the active one")

    def invoke(self, context, event):
        """Open the dialog with the subject's name."""
        if not context.preferences.filepaths.asset_libraries:
            return failures.report_and_cancel(self, InputError(_NO_LIBRARY))
        self.asset_name = recovered_slot(context.object)[TAG]
        return context.window_manager.invoke_props_dialog(self, width=380)

    def draw(self, context) -> None:
        """Draw the dialog."""
        column = self.layout.column()
        column.use_property_split, column.use_property_decorate = True, False
        for name in ("library", "asset_name", "catalog", "author", "license", "tags"):
            column.prop(self, name)

    def execute(self, context):
        """Render the preview and write the asset. On an error nothing is written."""
        try:
            library = context.preferences.filepaths.asset_libraries.get(self.library)
            if library is None:
                raise InputError(_NO_LIBRARY)
            folder = Path(bpy.path.abspath(library.path))
            if not library.path or not folder.is_absolute():
                raise InputError(
                    f"asset library '{library.name}' has no folder: choose one in Preferences › File Paths › Asset"
                    " Libraries"
                )
            shelf = Shelf(folder, self.catalog, self.author, self.license, tuple(self.tags.split(",")))
            name = self.asset_name.strip() or recovered_slot(context.object)[TAG]
            path = write_to_shelf(shelf, context.object, name)
        except InputError as error:
            return failures.report_and_cancel(self, error, {"--asset-name": "Name"})
        self.report({"INFO"}, rpt("{file} is in the library {library}", file=path.name, library=library.name))
        return {"FINISHED"}


CLASSES = (IRPSO_OT_save_asset,)
