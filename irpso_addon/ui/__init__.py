"""What an artist sees of the program inside Blender: settings, panels, operators, overlays, preferences."""
