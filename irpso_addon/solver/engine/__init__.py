"""Recoveries: whole, coarse to fine, in rounds of interreflection, in tiles. Steps, halos between tiles, maps, confidence."""
