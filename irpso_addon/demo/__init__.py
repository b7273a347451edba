"""The paper's experiment on a synthetic subject: render, recover, compare, keep the material."""
