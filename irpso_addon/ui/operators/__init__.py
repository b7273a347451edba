"""Operators, one file a job: import, set up, recover, restore, export."""
