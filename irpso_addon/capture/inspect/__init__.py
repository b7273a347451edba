"""Checks of a capture: lights, images, encoding, and what the set of lights is sufficient for."""
