"""Detection of a flat subject in photographs: by a printed marker board around it, or as the only rectangle."""
