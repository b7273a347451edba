"""Finds a flat subject in photographs: by printed markers around it, or as their one rectangle."""
