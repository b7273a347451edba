"""Recovered maps as a Blender material: images, node trees, displacement, tangent frames."""
