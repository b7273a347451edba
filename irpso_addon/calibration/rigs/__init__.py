"""Rigs: lamps, cameras and corrections that are calibrated once and applied to any number of captures."""
