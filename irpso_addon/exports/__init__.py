"""Writes results in other programs' formats."""
