"""Visibility of the seams of ``irpso tile``, against a mirror and a cross-fade, on six textures.

Usage: python -m benchmarks.seams [--quick] [--again] [--output FOLDER]

Two textures are maps of ambientCG (../shared/data/materials), four are made here; all are pieces that do not repeat.
The measures use the shaded result alone, not the path of the cut:

- foreign: share of patches farther from their nearest patch of the texture than nine in ten patches of one half of the
  texture are from the other half (Simakov et al. 2008, one term of their similarity): broken, faded or doubled detail;
- contrast: that of fine detail in the dullest windows, over that of the texture: blur;
- mirrored: the largest correlation of the detail on one side of a line with the mirrored other side, over all lines.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter, uniform_filter
from scipy.spatial import cKDTree

from benchmarks import report
from irpso_addon.core.encode import srgb_from_linear
from irpso_addon.core.png import encode_png
from irpso_addon.geometry.spaces import unit
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.seamless import seamless

_SIDE = 400  # texels of a piece: no multiple of a period
_FOREIGN = 0.9  # quantile of the distances between the texture's halves
_PATCH = 9  # texels along a side of a patch
_COMPONENTS = 24  # principal components of a patch
_SAMPLED = 6000  # compared patches of a picture
_LIGHT = np.array([0.5, 0.4, 0.77])
_DATA = report.ROOT.parent / "shared" / "data" / "materials"

Values = dict[str, np.ndarray]


def cloth(side: int) -> Values:
    """Return a plain weave, pitch 17.3 texels, of yarns that vary in width and colour."""
    pitch, rng = 17.3, np.random.default_rng(1)
    y, x = np.mgrid[:side, :side] + 1.2 * _noise(rng, (2, side, side), 40)
    across, along = np.pi * x / pitch, np.pi * y / pitch
    over = np.sin(across) * np.sin(along) > 0
    warp, weft = np.abs(np.sin(across)) ** 0.7, np.abs(np.sin(along)) ** 0.7
    height = 2.5 * np.where(over, weft, warp) + 0.2 * _noise(rng, (side, side), 1.5)
    tone = np.where(over, 0.5, 0.42) * (0.8 + 0.2 * np.where(over, weft, warp))
    return _maps(height, tone[..., None] * np.array([0.35, 0.45, 0.9]), np.full((side, side), 0.8))


def bricks(side: int) -> Values:
    """Return a running bond of bricks of 61 × 26 texels, of varying colour, slightly distorted."""
    length, rise, rng = 61.0, 26.0, np.random.default_rng(2)
    y, x = np.mgrid[:side, :side] + 0.8 * _noise(rng, (2, side, side), 12)
    row = np.floor(y / rise)
    shifted = x / length + 0.5 * (row % 2)
    column = np.floor(shifted)
    edge = np.minimum(
        np.minimum(shifted - column, 1 - shifted + column) * length,
        np.minimum(y / rise - row, 1 - y / rise + row) * rise,
    )
    brick = np.clip((edge - 1.5) / 2.5, 0, 1)
    tone = rng.uniform(0.7, 1.25, 4096)[((row * 37 + column) % 4096).astype(int)]
    tone = tone * (1 + 0.06 * _noise(rng, (side, side), 2))
    colour = brick[..., None] * tone[..., None] * np.array([0.42, 0.13, 0.08]) + (1 - brick[..., None]) * 0.45
    height = 3 * brick + 0.35 * _noise(rng, (side, side), 2)
    return _maps(height, colour, 0.65 + 0.25 * (1 - brick))


def wood(side: int) -> Values:
    """Return the grain of a board, along its height."""
    rng = np.random.default_rng(3)
    x = np.mgrid[:side, :side][1] + 9 * gaussian_filter(rng.normal(size=(side, side)), (60, 14)) * 40
    rings = 0.5 + 0.5 * np.sin(2 * np.pi * x / 23)
    fibre = gaussian_filter(rng.normal(size=(side, side)), (14, 0.7))
    fibre /= fibre.std()
    tone = 0.45 + 0.35 * rings**2 + 0.06 * fibre
    return _maps(0.4 * fibre + rings, tone[..., None] * np.array([0.6, 0.34, 0.16]), 0.45 + 0.1 * rings)


def hammered(side: int) -> Values:
    """Return copper with a hammer's dents at random positions."""
    rng = np.random.default_rng(4)
    places = rng.uniform(-20, side + 20, (int((side + 40) ** 2 / 420), 2))
    y, x = np.mgrid[:side, :side]
    distance = cKDTree(places).query(np.stack([y, x], axis=-1))[0]
    height = gaussian_filter(0.012 * distance**2, 1.2) + 0.05 * _noise(rng, (side, side), 1)
    stain = 1 + 0.1 * _noise(rng, (side, side), 25)
    maps = _maps(height, stain[..., None] * np.array([0.8, 0.4, 0.25]), 0.32 + 0.04 * _noise(rng, (side, side), 8))
    return {**maps, "metallic": np.ones((side, side, 1))}


def scanned(name: str, side: int) -> Values:
    """Return a piece of a scanned material, at half its size."""
    from benchmarks.scenes.textured import cc0_maps

    material = cc0_maps(_DATA / name, 512, 512)
    part = np.s_[40 : 40 + side, 40 : 40 + side]
    maps = _maps(np.zeros((side, side)), material.base_color[part], material.roughness[part])
    return {**maps, "normal": material.normal[part].astype(np.float64)}


TEXTURES: dict[str, Callable[[int], Values]] = {
    "rock, scanned": partial(scanned, "rock"), "mossy rock, scanned": partial(scanned, "mossyrock"),
    "cloth": cloth, "bricks": bricks, "wood": wood, "hammered copper": hammered,
}  # fmt: skip


def tiled(values: Values) -> Values:
    """Return the program's tile, at the texture's resolution."""
    model = load_model("metallic_roughness")
    covered = np.ones(values["normal"].shape[:2], bool)
    tile = seamless(model, values, covered, size=0)
    return {name: value.astype(np.float64) for name, value in tile.values.items()}


def cross_faded(values: Values) -> Values:
    """Return the texture with a linear cross-fade of its ends over a quarter of the side."""
    result = {}
    for name, value in values.items():
        over = len(value) // 4
        share = ((np.arange(over) + 0.5) / over)[:, None, None]
        for _ in range(2):
            faded = share * value[:over] + (1 - share) * value[-over:]
            value = np.concatenate([faded, value[over:-over]]).swapaxes(0, 1)
        result[name] = value
    return {**result, "normal": unit(result["normal"])}


def mirrored(values: Values) -> Values:
    """Return the texture beside its mirror images, with mirrored normals."""
    result = {}
    for name, value in values.items():
        for axis in (0, 1):
            other = np.flip(value, axis)
            if name == "normal":
                other = other * np.where(np.arange(3) == 1 - axis, -1, 1)
            value = np.concatenate([value, other], axis)
        result[name] = value
    return result


METHODS: dict[str, Callable[[Values], Values]] = {
    "irpso tile": tiled, "cross-fade": cross_faded, "mirror": mirrored,
}  # fmt: skip


def measure(quick: bool) -> dict[str, Any]:
    """Tile all textures by all methods; return the figures, and write the pictures into the cache."""
    figures: dict[str, dict[str, Any]] = {}
    for name, make in TEXTURES.items():
        if make is not cloth and quick:
            continue
        if isinstance(make, partial) and not _DATA.is_dir():
            report.say(f"{name}: {_DATA} is not there")
            continue
        values = make(_SIDE)
        own = shaded(values)
        judge = Judge(own)
        figures[name] = {"itself": judge.figures(own, repeats=False)}
        for method, tile in METHODS.items():
            picture = shaded(tile(values))
            figures[name][method] = {**judge.figures(picture), "period": list(picture.shape[1::-1])}
            (report.CACHE / "seams").mkdir(parents=True, exist_ok=True)
            shown = srgb_from_linear(np.clip(np.tile(picture, (3, 3, 1)), 0, 1))
            encode_png(report.CACHE / "seams" / f"{name} {method}.png", shown, bits=8)
        report.say(f"{name}: {figures[name]}")
    return {"side": _SIDE, "textures": figures}


class Judge:
    """Measures pictures (H, W, 3) against the texture's."""

    def __init__(self, own: np.ndarray) -> None:
        """own: the texture's picture, (H, W, 3)."""
        half = len(own) // 2
        first, second = patches(own[:half]), patches(own[half:])
        self._mean = first.mean(axis=0)
        _, _, rows = np.linalg.svd(first[::7] - self._mean, full_matrices=False)
        self._axes = rows[:_COMPONENTS].T
        self._limit = np.quantile(nearest(self._projected(first), self._projected(chosen(second))), _FOREIGN)
        self._all = self._projected(patches(own))
        self._contrast = contrast(own)

    def _projected(self, rows: np.ndarray) -> np.ndarray:
        return (rows - self._mean) @ self._axes

    def figures(self, picture: np.ndarray, repeats: bool = True) -> dict[str, float]:
        """Return the measures of the module's docstring."""
        wide = np.pad(picture, ((0, _PATCH), (0, _PATCH), (0, 0)), mode="wrap") if repeats else picture
        distance = nearest(self._all, self._projected(chosen(patches(wide))))
        return {
            "foreign": float((distance > self._limit).mean()),
            "contrast": float(np.quantile(contrast(picture), 0.02) / np.quantile(self._contrast, 0.02)),
            "mirrored": mirror_line(np.tile(picture, (2, 2, 1)) if repeats else picture),
        }


def patches(picture: np.ndarray) -> np.ndarray:
    """Return all patches (N, _PATCH² · 3)."""
    windows = np.lib.stride_tricks.sliding_window_view(picture.astype(np.float32), (_PATCH, _PATCH), axis=(0, 1))
    return windows.reshape(-1, _PATCH * _PATCH * 3)


def chosen(candidates: np.ndarray) -> np.ndarray:
    """Return a random sample of ``candidates`` (M, C), at the same positions for equal numbers of them."""
    return candidates[np.random.default_rng(0).permutation(len(candidates))[:_SAMPLED]]


def nearest(candidates: np.ndarray, queries: np.ndarray) -> np.ndarray:
    """Return (N,), the distance of each of ``queries`` (N, C) from the nearest of ``candidates`` (M, C)."""
    lengths = (candidates**2).sum(axis=-1)
    parts = [
        (lengths - 2 * rows @ candidates.T).min(axis=1) + (rows**2).sum(axis=-1)
        for rows in np.array_split(queries, len(queries) // 200)
    ]
    return np.sqrt(np.maximum(np.concatenate(parts), 0))


def contrast(picture: np.ndarray) -> np.ndarray:
    """Return (H, W), the root mean square of fine detail in windows of a fifteenth of _SIDE."""
    grey = picture.mean(axis=-1)
    detail = grey - gaussian_filter(grey, 3, mode="wrap")
    window = _SIDE // 15
    return np.sqrt(uniform_filter(detail**2, window, mode="wrap"))[window:-window, window:-window]


def mirror_line(picture: np.ndarray, reach: int = 24) -> float:
    """Return the largest correlation of detail left of a column, or above a row, with the mirrored detail beyond."""
    grey = picture.mean(axis=-1)
    detail = grey - gaussian_filter(grey, 6)
    best = 0.0
    for image in (detail, detail.T):
        for column in range(reach, image.shape[1] - reach):
            left, right = image[:, column - reach : column], image[:, column : column + reach][:, ::-1]
            best = max(best, float((left * right).mean() / np.sqrt((left**2).mean() * (right**2).mean())))
    return best


def shaded(values: Values) -> np.ndarray:
    """Return (H, W, 3), the maps under one light: a diffuse part, and a GGX highlight."""
    light = _LIGHT / np.linalg.norm(_LIGHT)
    half = unit(light + np.array([0, 0, 1.0]))
    normal = values["normal"]
    cosine = np.clip(normal @ light, 0, None)[..., None]
    alpha2 = np.clip(values["roughness"], 0.1, 1) ** 4
    lobe = alpha2 / (np.pi * ((np.clip(normal @ half, 0, None)[..., None] ** 2) * (alpha2 - 1) + 1) ** 2)
    metal, colour = values["metallic"], values["base_color"]
    return cosine * (colour * (1 - metal) + (0.04 + metal * (colour - 0.04)) * np.minimum(lobe, 8) / 4 * np.pi)


def write(data: dict[str, Any], folder: Path) -> list[str]:
    """Return the page's lines."""
    lines = [
        f"Pieces of {data['side']} × {data['side']} texels that do not repeat, made to repeat by `irpso tile`, by a"
        " cross-fade of a quarter of the side, and by a mirror. *Foreign*: patches less like any of the texture than"
        " nine in ten of one half of it are like one of the other. *Contrast*: of fine detail in the dullest windows,"
        " over that of the texture: 1 is no blur. *Mirrored*: the strongest mirror line, 1 is a mirror. All of shaded"
        " pictures; see [seams.py](../../benchmarks/seams.py). *Period*: texels of the piece that repeat.",
        "",
        "| texture | period | foreign %: " + " | ".join(METHODS) + " | contrast: " + " | ".join(METHODS)
        + " | mirrored: " + " | ".join(["itself", *METHODS]) + " |",
        "|---" * (2 + 3 + 3 + 4) + "|",
    ]  # fmt: skip
    for name, of in data["textures"].items():
        foreign = [f"{100 * of[m]['foreign']:.1f}" for m in METHODS]
        least = [f"{of[m]['contrast']:.2f}" for m in METHODS]
        line = [f"{of[m]['mirrored']:.2f}" for m in ("itself", *METHODS)]
        period = " × ".join(str(texels) for texels in of["irpso tile"]["period"])
        lines.append(" | ".join([f"| {name}", period, *foreign, *least, *line]) + " |")
    return lines


def headline(data: dict[str, Any]) -> str:
    """Return the text of the index."""
    worst = {m: max(of[m]["foreign"] for of in data["textures"].values()) for m in METHODS}
    return "foreign patches at most: " + ", ".join(f"{m} {100 * share:.1f} %" for m, share in worst.items())


def _noise(rng: np.random.Generator, shape: tuple[int, ...], grain: float) -> np.ndarray:
    """Return noise of standard deviation 1, smooth over ``grain`` texels in the last two axes."""
    noise = gaussian_filter(rng.normal(size=shape), (0,) * (len(shape) - 2) + (grain, grain))
    return noise / noise.std()


def _maps(height: np.ndarray, colour: np.ndarray, roughness: np.ndarray) -> Values:
    """Return the maps of a dielectric with a height field in texels."""
    down, right = np.gradient(height)
    normal = unit(np.stack([-right, -down, np.ones_like(height)], axis=-1))
    one = np.ones((*height.shape, 1))
    return {
        "base_color": np.clip(colour, 0, 1), "normal": normal, "roughness": np.clip(roughness, 0.05, 1)[..., None],
        "metallic": 0 * one, "specular": 0.5 * one,
    }  # fmt: skip


PROGRAM = report.Program(
    "seams", "Seams of maps that repeat", __file__, measure, write, headline,
    (*report.CAPTURE, "irpso_addon/exports", "benchmarks/scenes"),
)  # fmt: skip

if __name__ == "__main__":
    report.run(PROGRAM)
