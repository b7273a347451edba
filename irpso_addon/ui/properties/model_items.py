"""The models that the scene's settings offer, with the numbers that a .blend stores for them."""

from zlib import crc32

from ...reflectance.model import load_model, shipped_models

CUSTOM = "CUSTOM"  # the user's own model


def _model_item(name: str) -> tuple[str, str, str, int]:
    """Return the entry of a shipped model: the short part of its title as name, the long part as tooltip, its number.

    A .blend stores the number. Models of 0.1.0 have their places of that time, others a number of their name.
    """
    short, _, long = load_model(name).title.partition(": ")
    number = _FIRST_MODELS.index(name) if name in _FIRST_MODELS else crc32(name.encode()) >> 1
    return name, short, (long or short)[:1].upper() + (long or short)[1:], number


_FIRST_MODELS = (
    *("anisotropic", "clear_coat", "cook_torrance_two_lobe", "lambert", "metallic_roughness", "principled"),
    *("principled_metallic", "principled_two_lobe", CUSTOM),
)
MODEL_ITEMS = [
    *(_model_item(name) for name in shipped_models()),
    (
        CUSTOM, "Custom Model…", "A .toml that declares the parameters, with its .glsl beside it",
        _FIRST_MODELS.index(CUSTOM),
    ),
]  # fmt: skip
