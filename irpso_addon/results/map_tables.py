"""``MapTable``: the parameters of a model that share one map, and their encoding as channels of a picture."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from ..core.encode import FLAT_NORMAL, encode_normal, fill_margin, srgb_from_linear
from ..core.errors import InputError
from ..reflectance.model import Parameter, ReflectanceModel
from .maps import Maps

_CHANNELS = {1: "Y", 3: "RGB", 4: "RGBA"}
_FILE_STEM = re.compile(r"[A-Za-z0-9_-]+$")
OTHER_SPACES = ("normal_object", "normal_world", "normal_directx")  # stems of a result's normals that are no map
# Stems of a result's files other than the maps of its model.
OTHER_FILES = ("maps", "residual", "confidence", "preview", "convergence", "relit", "height", "indirect", *OTHER_SPACES)
ALPHA = 3  # the channel that a picture without alpha has as 1
_GREY = 0.02  # of a range: channels that are farther apart are no grey
_RESERVED = {*OTHER_FILES, "coverage", "strip", "live", "repeated"}


@dataclass(frozen=True)
class MapTable:
    """One map. name: file stem. parameters: their components are its channels, in order."""

    name: str
    parameters: tuple[Parameter, ...]

    @property
    def components(self) -> int:
        """Number of channels in use."""
        return sum(p.components for p in self.parameters)

    def first_channel(self, name: str) -> int:
        """Return the index of a parameter's first channel."""
        index = next(index for index, p in enumerate(self.parameters) if p.name == name)
        return sum(p.components for p in self.parameters[:index])

    def channels_of(self, name: str, values: np.ndarray, where: str) -> np.ndarray:
        """Return (H, W, components) of one parameter from a picture's channels (H, W, C).

        They are its own if the picture has those of the whole map, else the first. A grey picture whose alpha is 1 has
        one. Raises InputError, naming ``where``, if they are too few, or if one number has several that differ.
        """
        parameter = next(p for p in self.parameters if p.name == name)
        at = self.first_channel(name) if values.shape[-1] >= self.components else 0
        if at == ALPHA and (values[..., at] == 1).all() and not np.ptp(values[..., :at], axis=-1).any():
            at = 0
        own = values[..., at : at + parameter.components]
        if own.shape[-1] < parameter.components:
            raise InputError(
                f"{where}: {name} has {parameter.components} channels, the file {values.shape[-1]}; save it as R, G, B"
            )
        if self.components == 1 and values.shape[-1] > 1:
            apart = np.ptp(values[..., :3], axis=-1)  # the median: margins and backgrounds may be coloured
            if apart.size and np.median(apart) > _GREY * min(parameter.width, 1.0):
                raise InputError(
                    f"{where}: its channels differ, and {name} is one number; save the channel of {name} alone"
                )
        return own

    @property
    def is_normal(self) -> bool:
        """Whether it is a normal map."""
        return self.parameters[0].is_normal

    @property
    def color_space(self) -> str:
        """Blender's name of the colour space of its 8/16-bit picture."""
        return self.parameters[0].color_space

    @property
    def fits_unit(self) -> bool:
        """Whether the values, or their standard encoding, lie in 0…1, so that a PNG stores them unscaled."""
        in_unit = all(p.range[0] >= 0 and p.range[1] <= 1 for p in self.parameters)
        return self.is_normal or in_unit


def map_tables(model: ReflectanceModel) -> list[MapTable]:
    """Return a model's maps in the order of its parameters. Raises InputError if a map cannot be written."""
    grouped: dict[str, list[Parameter]] = {}
    for parameter in model.parameters:
        grouped.setdefault(parameter.map, []).append(parameter)
    tables = [MapTable(name, tuple(parameters)) for name, parameters in grouped.items()]
    for table in tables:
        what = f"model {model.name}: the map '{table.name}'"
        if not _FILE_STEM.match(table.name) or table.name.lower() in _RESERVED:
            raise InputError(f"{what} cannot be a file name; use letters, digits, _ and -, and no other file's name")
        if table.components > 4:
            raise InputError(f"{what} is shared by {table.components} components; a picture has 4, so use two maps")
        if len(table.parameters) > 1 and (any(p.is_normal for p in table.parameters)):
            raise InputError(f"{what} is shared with a normal; give the normal a map of its own")
        if len({p.color_space for p in table.parameters}) > 1:
            raise InputError(f"{what} is shared by parameters of two colour spaces; give each its own map")
    return tables


def table_of(model: ReflectanceModel, name: str) -> MapTable:
    """Return the map that holds a parameter. Raises InputError as ``map_tables``."""
    return next(table for table in map_tables(model) if any(p.name == name for p in table.parameters))


def map_values(table: MapTable, maps: Maps) -> np.ndarray:
    """Return (H, W, components) float32 of a map, with a margin of 8 texels around the solved ones.

    Texels outside the margin have the mean, or a flat normal. Missing parameters have their default.
    """
    shape = maps.solved.shape
    values = [
        np.asarray(maps.values[p.name], np.float32).reshape(*shape, p.components)
        if p.name in maps.values
        else np.broadcast_to(np.asarray(p.default, np.float32), (*shape, p.components))
        for p in table.parameters
    ]
    far = FLAT_NORMAL if table.is_normal else None
    return fill_margin(np.concatenate(values, axis=-1), maps.solved, far=far, keep=maps.margin)


def encoded_values(table: MapTable, values: np.ndarray) -> np.ndarray:
    """Return (H, W, 1, 3 or 4) values in 0…1 for a PNG: sRGB, normal encoding, or unchanged values.

    Linear values of a range beyond 0…1 are encoded as a fraction of it, sRGB ones are clipped. The fourth channel of an
    sRGB map is unchanged. Two channels get a third, black one.
    """
    if table.is_normal:
        return encode_normal(values)
    if table.color_space == "sRGB":
        # A file's fourth channel is alpha, to which no reader applies the curve.
        encoded = np.concatenate([srgb_from_linear(values[..., :3]), values[..., 3:]], axis=-1)
    elif table.fits_unit:
        encoded = values
    else:
        low = np.concatenate([np.full(p.components, p.range[0]) for p in table.parameters])
        high = np.concatenate([np.full(p.components, p.range[1]) for p in table.parameters])
        encoded = (values - low) / (high - low)
    return np.clip(np.nan_to_num(_with_black(encoded)), 0, 1).astype(np.float32)


def exr_channels(values: np.ndarray) -> dict[str, np.ndarray]:
    """Return channel name → (H, W) float32 of (H, W, C) values: Y, RGB or RGBA, which every reader shows as a picture.

    Two channels get a third, black one: Blender 5.0 does not initialise a missing blue channel, and Cycles renders a
    texel with any channel that is not finite as black.
    """
    values = _with_black(values)
    names = _CHANNELS[values.shape[-1]]
    return {name: np.ascontiguousarray(values[..., i], np.float32) for i, name in enumerate(names)}


def _with_black(values: np.ndarray) -> np.ndarray:
    if values.shape[-1] != 2:
        return values
    return np.concatenate([values, np.zeros_like(values[..., :1])], axis=-1)


def encoding_text(table: MapTable) -> str:
    """Return the encoding of a map's PNG in words, for the report."""
    if table.is_normal:
        return "0.5 * n + 0.5, OpenGL (Y+)"
    if table.color_space == "sRGB":
        return "sRGB, the fourth channel linear" if table.components == 4 else "sRGB"
    if table.fits_unit:
        return "linear"
    ranges = ", ".join(f"{p.name} {p.range[0]:g} to {p.range[1]:g}" for p in table.parameters)
    return f"fraction of the range ({ranges})"
