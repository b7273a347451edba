"""One large swarm on many processors: the paper's second axis of parallelism (Sect. 5, Fig. 8)."""
