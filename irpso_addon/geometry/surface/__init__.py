"""Surfaces as texels: meshes, UV layouts, bakes, footprints of texels in images."""
