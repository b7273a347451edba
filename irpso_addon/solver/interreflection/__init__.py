"""Rounds of interreflection: indirect light estimated from the maps, photographs without it, recovery again."""
