"""UV seams: which texels are neighbours on the surface though the UV map cuts them apart."""
