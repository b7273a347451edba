"""Hand-held photographs with a flash beside the lens: cameras, lamp and beam (Riviere, Peers & Ghosh 2016)."""
