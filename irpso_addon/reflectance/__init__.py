"""Reflectance models: pairs of a .glsl and a .toml file, the black box of the paper."""
