"""The window's recovery: built from the scene's settings, stepped, shown, kept or stored."""
