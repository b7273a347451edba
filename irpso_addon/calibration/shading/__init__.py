"""Lights without a ball: distant lights from the shading of a subject with relief."""
