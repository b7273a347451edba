"""Phases: normal prefit, sequential and synchronous swarms, refinement, shared materials, spatial prior, surface."""
