"""The paper's experiment on a synthetic subject: render, recover, compare, store the material."""
