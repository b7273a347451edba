"""The one recovery of the window: from the scene's settings to a job, stepped, looked at, kept or stored."""
