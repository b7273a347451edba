"""The paper's experiment on a subject made in code: render, recover, compare, keep the material."""
