"""Recoveries: whole, coarse to fine, in tiles. Steps, halos between tiles, maps, confidence."""
