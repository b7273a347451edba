"""UV seams: texels that are neighbours on the surface but not in the UV map."""
