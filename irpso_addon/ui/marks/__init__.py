"""Operators that mark things in a photograph, in an Image editor."""
