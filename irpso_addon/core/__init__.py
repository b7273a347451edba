"""Errors, paths, files, stepwise work, PNG, colour encoding, drawing, graphs: what every room may use."""
