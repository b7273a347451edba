"""Capture formats: capture.toml tables, DiLiGenT folders, RTI .lp lists; and the TOML reader they share."""
