"""Captures with known truth by an independent renderer: subjects, materials and lights rendered by Cycles."""
