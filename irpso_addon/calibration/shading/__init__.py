"""Lights without a ball: from the shading of a subject with relief, of a known shape, or of a flat card."""
