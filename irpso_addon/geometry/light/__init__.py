"""Light on a mesh: shadows, beam shapes, and light transport between the parts of the mesh itself."""
