"""Commands of the command line: one module per command, with ``run(options) -> dict``, which --json prints."""
