"""Subjects, materials and lights that Cycles photographs: captures whose truth is known, by an independent renderer."""
