"""Detection of mirror and matte balls in photographs that a lamp lights from different sides."""
