"""Operators, one file per job: import, set up, recover, restore, export."""
