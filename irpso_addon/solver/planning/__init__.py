"""Costs and budgets: bytes and evaluations of a texel, memory of the machine, the plan of tiles."""
