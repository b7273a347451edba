"""Draws the window's panels into a fake layout that checks each property, operator and icon."""

from types import SimpleNamespace

import bpy

ICONS = set(bpy.types.UILayout.bl_rna.functions["label"].parameters["icon"].enum_items.keys())


class Drawn:
    """A fake layout: records what is drawn; fails on properties, operators and icons that Blender lacks."""

    def __init__(self, notes=None):
        object.__setattr__(self, "notes", {"props": [], "operators": [], "texts": []} if notes is None else notes)

    def __setattr__(self, name, value):
        assert name in bpy.types.UILayout.bl_rna.properties, name
        object.__setattr__(self, name, value)

    def _inner(self, **options):
        assert set(options) <= {"align", "heading", "factor"}
        return Drawn(self.notes)

    row = column = box = split = _inner

    def label(self, text="", icon="NONE", translate=True):
        assert icon in ICONS, icon
        self.notes["texts"].append(text)

    def separator(self):
        pass

    def progress(self, factor=0.0, type="BAR", text="", translate=True):
        assert 0 <= factor <= 1
        self.notes["texts"].append(text)

    def prop(self, data, name, text=None, **options):
        assert name in data.bl_rna.properties, name
        assert set(options) <= {"expand", "slider", "translate", "icon", "index"}
        self.notes["props"].append(name)

    def template_ID(self, data, name, open=""):
        assert name in data.bl_rna.properties
        self.notes["props"].append(name)

    def menu(self, name, text="", icon="NONE", translate=True):
        assert hasattr(bpy.types, name) and icon in ICONS, (name, icon)
        self.notes["texts"].append(text)

    def popover(self, panel, text="", icon="NONE"):
        assert icon in ICONS, icon
        self.notes["texts"].append(text)
        getattr(bpy.types, panel).draw(SimpleNamespace(layout=Drawn(self.notes)), bpy.context)

    def operator(self, name, text="", icon="NONE", emboss=True, translate=True):
        assert icon in ICONS, icon
        kind = getattr(bpy.types, "IRPSO_OT_" + name.partition(".")[2], None) or next(
            (c for c in bpy.types.Operator.__subclasses__() if c.bl_idname == name and c.is_registered), None
        )
        assert kind is not None, name
        self.notes["operators"].append(name)
        return SimpleNamespace()


def panels(space="VIEW_3D"):
    """Return the panels that the tab shows now, with their children."""
    from irpso_addon.ui.panels import capture, image_editor, recovery, sidebar, view

    classes = [one for module in (sidebar, capture, recovery, view, image_editor) for one in module.CLASSES]
    own = [cls for cls in classes if cls.bl_space_type == space and cls.bl_region_type == "UI"]  # popovers have none
    shown = [cls for cls in own if not hasattr(cls, "poll") or cls.poll(bpy.context)]
    names = {cls.__name__ for cls in shown}
    return [cls for cls in shown if getattr(cls, "bl_parent_id", None) in (None, *names)]


def drawn(space="VIEW_3D"):
    """Draw all panels; return their props, operators and texts."""
    notes = Drawn().notes
    for cls in panels(space):
        panel = SimpleNamespace(layout=Drawn(notes))
        if hasattr(cls, "draw_header"):
            cls.draw_header(panel, bpy.context)
        cls.draw(panel, bpy.context)
    return SimpleNamespace(**notes)


def labels(space="VIEW_3D"):
    return [cls.bl_label for cls in panels(space)]
