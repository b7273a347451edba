"""Blender loads an extension through the ``__init__.py`` beside its manifest."""

from .irpso_addon import register, unregister  # noqa: F401
