"""Writes a sample's ground truth (maps, mask, lights, positions in the pictures) and a page of commands to try."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from ..blender.scenes.table_top import SUBJECT
from ..capture.formats.table import CARD_DISTANCE, FORMAT, TABLE
from ..capture.images.exr import write_exr
from ..core.png import encode_png
from ..core.toml_text import toml_value
from . import layout

TRUTH, MAPS, MASK, PLACES, PAGE = "truth", "maps.exr", "tile.png", "places.toml", "README.txt"
_WHOLE = 0.999  # coverage of a pixel that the tile fills


def write_truth(folder: Path, arrangement: layout.Layout, seen: Mapping[str, np.ndarray], names: Sequence[str]) -> None:
    """Write the truth and the page into ``folder``. seen: maps in the camera's view, row 0 at the bottom.

    names: of the photographs. Maps are 0 in pixels that the tile does not fill.
    """
    mask = seen[SUBJECT] > _WHOLE
    (folder / TRUTH).mkdir()
    masked = {name: np.where(mask if seen[name].ndim == 2 else mask[..., None], seen[name], 0) for name in seen}
    write_exr(folder / TRUTH / MAPS, {
        "normal": dict(zip("XYZ", np.moveaxis(masked["normal"], -1, 0), strict=True)),
        "base_color": dict(zip("RGB", np.moveaxis(masked["base_color"], -1, 0), strict=True)),
        "roughness": {"Y": masked["roughness"]},
        "metallic": {"Y": masked["metallic"]},
    })  # fmt: skip
    encode_png(folder / TRUTH / MASK, mask.astype(np.float64)[..., None], bits=8)
    (folder / TRUTH / TABLE).write_text("\n".join(_table(arrangement, names)) + "\n", encoding="utf-8")
    (folder / TRUTH / PLACES).write_text("\n".join(_places(arrangement)) + "\n", encoding="utf-8")
    (folder / PAGE).write_text(_page(arrangement, len(names)), encoding="utf-8")


def _table(arrangement: layout.Layout, names: Sequence[str]) -> Iterator[str]:
    """Yield the lines of a capture.toml with the true lights, in millimetres from the camera."""
    yield from (f"format = {FORMAT}", 'name = "sample"', 'colour_space = "srgb"')
    yield f"{CARD_DISTANCE} = {toml_value(arrangement.card_distance)}"
    yield from ("", "[[camera]]", f"fov_degrees = {toml_value(arrangement.fov_degrees)}", f'mask = "{MASK}"')
    for name, lamp in zip(names, arrangement.lamps - arrangement.camera.position, strict=True):
        yield from ("", "[[observation]]", f'image = "../photographs/{name}"', f"light_position = {toml_value(lamp)}")
        yield f"light_intensity = {toml_value(layout.LAMP_DISTANCE**2)}"


def _places(arrangement: layout.Layout) -> Iterator[str]:
    """Yield the lines of places.toml: pixels to the right and down from the upper left corner."""
    camera = arrangement.camera
    yield "# Pixels count to the right and down from the upper left corner of a photograph; lengths are millimetres."
    yield f"fov_degrees = {toml_value(arrangement.fov_degrees)}  # over the width"
    yield f"ball = {toml_value(np.round(layout.ball_circle(camera), 3))}  # x, y, radius of its outline"
    yield f"ball_radius = {layout.BALL_RADIUS}"
    yield f"ball_centre = {toml_value(layout.ball_middle() - camera.position)}  # from the camera; z is minus the depth"
    yield "# Upper left, upper right, lower right, lower left, at the height of its field"
    yield f"tile = {toml_value(np.round(layout.seen_from_upper_left(camera, layout.tile_corners()), 3))}"
    yield "# Outer corners of patches 1 (dark skin), 6, 24 (black) and 19 (white)"
    yield f"chart = {toml_value(np.round(layout.seen_from_upper_left(camera, layout.chart_corners()), 3))}"


def _page(arrangement: layout.Layout, count: int) -> str:
    card = f"{arrangement.card_distance:.0f}"
    ball = ",".join(f"{value:.1f}" for value in layout.ball_circle(arrangement.camera))
    crop = ",".join(map(str, layout.tile_crop(arrangement.camera)))
    lengths = f"--radius {layout.BALL_RADIUS:g} --lamp-distance {layout.LAMP_DISTANCE:g}"
    return f"""A capture to practise on
========================

Cycles rendered it, so everything about it is known. photographs/ holds what a phone gives: {count} pictures of
a glazed and gilded tile, a mirror ball ({2 * layout.BALL_RADIUS:g} mm) and a colour chart, in a dark room. A hand
moved the one lamp around them, on a string of {layout.LAMP_DISTANCE:g} mm from the ball. The camera stood still and
looked straight down.

Find the lights from the ball, then recover the maps of the tile. Type in this folder:

    irpso calibrate photographs {lengths} -o capture
    irpso recover capture --distance {round(arrangement.card_distance):d} --crop {crop} -o result

{layout.BALL_RADIUS:g} is the ball's radius: half of the diameter that a caliper shows.
{layout.LAMP_DISTANCE:g} is the string, from the ball's middle to the lamp: use a tape. {card} is from camera to tile.
All are millimetres, so the lamps' positions in capture/ are too. The maps have no unit: 0 to 1, normals of length 1.

The ball is searched; where it is too small for that, give its place: --ball {ball} --kind mirror.

The tile under its true lights, compared with its true maps:

    irpso recover {TRUTH}/{TABLE} --ground-truth {TRUTH}/{MAPS} -o result_true

truth/ holds what a photographer does not have:

    {MAPS:13} normal, base_color, roughness and metallic at every pixel of the tile
    {MASK:13} white on the pixels that the tile fills
    {TABLE:13} the places of the lamp, and the camera
    {PLACES:13} where ball, tile and chart are in the photographs
"""
