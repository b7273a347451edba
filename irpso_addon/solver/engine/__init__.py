"""Recoveries: whole, coarse to fine, in tiles. Steps, halos, maps, confidence."""
