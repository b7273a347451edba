"""Checks of a capture: lights, images, encoding, and the goals for which the lights suffice."""
