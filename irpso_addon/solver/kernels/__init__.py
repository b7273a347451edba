"""Shader passes of the phases: sources, constants, bindings; and the GLSL generated for one model."""
