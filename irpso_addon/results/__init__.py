"""Recovered maps and their output: ``Maps``, tables of maps, files, report, preview pictures."""
