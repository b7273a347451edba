"""Meshes and cards as grids of texels: bake, projection of images, seams, shadows, relief."""
