"""Shared parts of the user interface: text in panels, failures, features of Blender, paths."""
