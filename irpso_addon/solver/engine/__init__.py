"""Recoveries: whole, coarse to fine, in rounds of interreflection, in tiles. Steps, halos, maps, confidence."""
