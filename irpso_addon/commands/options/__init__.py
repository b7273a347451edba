"""Converts command-line options to values, photographs and a ``Job``; errors name the option."""
