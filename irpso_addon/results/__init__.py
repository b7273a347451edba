"""Recovered maps and their output: ``Maps``, tables, files, report, preview pictures."""
