"""State of a recovery: textures, dense packing, per-texel preparation, portable layout, checkpoints, other optima."""
