"""From words of the command line to values, photographs and a ``Job``, with errors that name the option."""
