"""One recovery, whoever asks: a ``Job`` goes read → lights → plan → prepare → solve → report."""
