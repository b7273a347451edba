"""Many processes, on one machine or many, that solve one domain together over MPI."""
