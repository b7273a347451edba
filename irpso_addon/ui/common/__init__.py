"""What every part of the user interface uses: text in panels, failures, features of Blender, paths."""
