"""Scenes as captures, and captures as scenes: cameras, lights, photographs."""
