"""What reaches a texel of a light: shadows of the mesh, the shape of the beam."""
