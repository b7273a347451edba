"""IRPSO recovers a material from photographs: normal, albedo and roughness maps by a particle swarm at every texel.

In Blender ``register`` adds the panels and the command ``blender --command irpso``. In Python the names of ``__all__``
are the public interface; their modules are imported at first access, so that numpy-only parts work without Blender.
"""

from importlib import import_module

_MODULES = {
    "read_capture": "capture.read",
    "load_model": "reflectance.model",
    "load_schedule": "solver.settings.schedule",
    "Recovery": "solver.engine.recovery",
    "Pyramid": "solver.engine.coarse_to_fine",
    "Domain": "geometry.domain",
    "domain_from_card": "geometry.build",
    "domain_from_mesh": "geometry.build",
    "extract_mesh": "blender.mesh",
    "estimate_lights": "solver.lights.refine",
    "Maps": "results.maps",
    "write_maps": "results.write",
}
__all__ = ["register", "unregister", *_MODULES]


def __getattr__(name: str):
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_MODULES[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULES})


def register() -> None:
    """Add the program to Blender: the command ``irpso`` and the user interface. Blender calls it on enabling."""
    from .ui import registration

    registration.register(_run_command)


def unregister() -> None:
    """Remove from Blender all that ``register`` added."""
    from .ui import registration

    registration.unregister()


def _run_command(argv: list[str]) -> int:
    from . import cli

    return cli.main(argv)
