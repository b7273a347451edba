"""Schedules: presets, settings with their limits, and the phases that they resolve to for one model."""
