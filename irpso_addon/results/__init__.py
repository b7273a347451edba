"""Recovered maps and what is written of them: ``Maps``, tables, files, report, preview pictures."""
