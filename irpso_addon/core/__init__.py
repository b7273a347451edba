"""Errors, paths, files, stepwise work, PNG, colour encoding, drawing: what every room may use."""
