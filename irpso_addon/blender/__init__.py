"""Blender's data: meshes, cameras and lights of scenes read; materials, nodes and images written."""
