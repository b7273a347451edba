"""Light on its way to a mesh: shadows, the shape of the beam, and what the mesh exchanges with itself."""
