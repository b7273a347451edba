"""Visibility of lights: shadows of the mesh, and the shape of the beam."""
