"""Costs and budgets: bytes and evaluations per texel, the machine's memory, the plan of tiles."""
