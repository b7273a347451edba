"""The user interface in Blender: settings, panels, operators, overlays, preferences."""
