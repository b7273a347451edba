"""Light transport to a mesh: shadows, beam shapes, and interreflection on the mesh itself."""
