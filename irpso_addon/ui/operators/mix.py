"""Mixes the recovered material of the active object with another one, in a new material."""

from __future__ import annotations

import bpy
from bpy.props import EnumProperty, FloatProperty, StringProperty

from ...blender.materials.material import TAG, apply_material, check_object
from ...blender.materials.mixture import mix_materials
from ...core.errors import InputError
from ..common import failures
from ..common.polls import usable
from ..common.words import rpt

_MASK_SIDE = 1024  # pixels of a new mask
_BY = (
    ("NEW", "New Mask", "A black image, in which you then paint the other material white"),
    ("IMAGE", "Mask", "An image in the active UV map: the other material shows where it is white"),
    ("FACTOR", "Factor", "One number for the whole surface"),
)
_items: list[tuple[str, str, str]] = []  # of the menu: kept here because Blender holds no reference


def _others(_operator, context) -> list[tuple[str, str, str]]:
    """Return the recovered materials other than the active one, as items of a menu."""
    _items[:] = [(one.name_full, one.name_full, "") for one in _mixable(context)]
    return _items


def _mixable(context) -> list[bpy.types.Material]:
    """Return the recovered materials other than the active one. Linked ones may have its name, never its full name."""
    active = context.object.active_material if context.object is not None else None
    return [one for one in bpy.data.materials if TAG in one and one != active]


class IRPSO_OT_mix_captures(bpy.types.Operator):
    """Mix the recovered material of the active object with that of another capture, in a new material. Both stay"""

    bl_idname = "irpso.mix_captures"
    bl_label = "Mix Captures"
    bl_options = {"REGISTER", "UNDO"}

    other: EnumProperty(name="Other", description="The recovered material to mix in", items=_others)
    by: EnumProperty(name="Mix By", description="What decides where each material shows", items=_BY, default="NEW")
    mask: StringProperty(name="Mask", description="Black shows the active material, white the other one")
    factor: FloatProperty(
        name="Factor", description="0 is the active material, 1 the other one", subtype="FACTOR", min=0, max=1,
        default=0.5,
    )  # fmt: skip
    scale: FloatProperty(
        name="Scale", description="How many times the other material's maps repeat along the UV square, for a close-up"
        " of the same surface", min=0.001, max=1000, soft_min=0.1, soft_max=100, default=1,
    )  # fmt: skip

    @classmethod
    def poll(cls, context) -> bool:
        """Whether the active object has a recovered material, and there is another one."""
        obj = context.object
        active = obj.active_material if obj is not None else None
        if not usable(cls, active is not None and TAG in active, "Make an object with a recovered material active"):
            return False
        others = bool(_mixable(context))
        return usable(cls, others, "There is no other recovered material in this file: keep or append one")

    def invoke(self, context, event):
        """Open the dialog."""
        return context.window_manager.invoke_props_dialog(self, width=380)

    def draw(self, context) -> None:
        """Draw the dialog."""
        column = self.layout.column()
        column.use_property_split, column.use_property_decorate = True, False
        column.prop(self, "other")
        column.prop(self, "by")
        if self.by == "IMAGE":
            column.prop_search(self, "mask", bpy.data, "images")
        elif self.by == "FACTOR":
            column.prop(self, "factor")
        column.prop(self, "scale")

    def execute(self, context):
        """Make the material and put it into the active slot. On an error nothing is made."""
        obj = context.object
        first = obj.active_material
        second = next((one for one in _mixable(context) if one.name_full == self.other), None)
        try:
            if second is None:
                raise InputError("Other: no material is chosen; choose one")
            check_object(obj)
            mixed = self._mixed(first, second)
            apply_material(obj, mixed)
        except InputError as error:
            return failures.report_and_cancel(self, error)
        self.report({"INFO"}, rpt("Material '{name}' on '{object}'", name=mixed.name, object=obj.name))
        if displaced := [one.name for one in (first, second) if _displaces(one)]:
            self.report({"WARNING"}, rpt("The mix has no displacement, unlike '{name}'", name=displaced[0]))
        return {"FINISHED"}

    def _mixed(self, first, second):
        """Return the mixed material. Raises InputError, and then removes a new mask."""
        mask = self._mask()
        try:
            return mix_materials(first, second, mask, self.factor, self.scale)
        except InputError:
            if self.by == "NEW":
                bpy.data.images.remove(mask)
            raise

    def _mask(self):
        """Return the chosen mask image or a new one, None for By: Factor. Raises InputError."""
        if self.by == "FACTOR":
            return None
        if self.by == "NEW":
            return bpy.data.images.new("IRPSO Mask", _MASK_SIDE, _MASK_SIDE, is_data=True)
        if self.mask not in bpy.data.images:
            raise InputError("Mask: no image is chosen; choose one, or By: New Mask")
        return bpy.data.images[self.mask]


def _displaces(material) -> bool:
    output = material.node_tree.get_output_node("ALL")
    return output is not None and output.inputs["Displacement"].is_linked


def _menu(self, context) -> None:
    self.layout.separator()
    self.layout.operator(IRPSO_OT_mix_captures.bl_idname, text="Mix Captures (IRPSO)…")


CLASSES = (IRPSO_OT_mix_captures,)


def register() -> None:
    """Add the entry to the menu beside the material's slots."""
    bpy.types.MATERIAL_MT_context_menu.append(_menu)


def unregister() -> None:
    """Remove the entry."""
    bpy.types.MATERIAL_MT_context_menu.remove(_menu)
