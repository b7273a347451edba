"""Calibration of a capture before it is solved: lights from balls, linear and even images. numpy only."""
