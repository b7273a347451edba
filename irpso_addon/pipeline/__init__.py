"""One recovery for command line, MPI and window: a ``Job`` goes read → lights → plan → prepare → solve → report."""
