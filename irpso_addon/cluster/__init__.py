"""Recovery of one domain by many processes, on one or many machines, over MPI."""
