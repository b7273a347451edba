"""Renders a sample: from options to files, for the command line and the window."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..blender.scenes import cycles, table_top
from ..blender.scenes.true_surface import TrueMaps
from ..core.errors import InputError
from ..core.files import check_unused, new_folder
from . import layout
from .chart import TALL, WIDE, chart_picture
from .photograph import developed, write_photograph
from .relief import HALF, tile
from .truth import write_truth

PHOTOGRAPHS, SIZE = 16, (640, 480)
MIN_PHOTOGRAPHS, MAX_PHOTOGRAPHS = 3, 200  # photographs
MIN_SIDE, MAX_SIDE = 80, 4096  # pixels of a side
_NARROW = 3  # largest ratio of the longer to the shorter side
FOLDER = "photographs"
_SAMPLES, _TRUTH_SAMPLES, _BOUNCES = 8, 32, 2
_QUADS = 1.5  # of the tile's mesh per pixel along a side
_MIN_QUADS, _MAX_QUADS = 600, 1600
_TABLE = 4000.0  # side of the table in millimetres
_SCENE = "IRPSO sample"


@dataclass(frozen=True)
class Request:
    """Options of a sample. photographs: number. size: (width, height) in pixels. seed: of lamp positions and noise.

    Raises InputError for numbers out of range.
    """

    photographs: int = PHOTOGRAPHS
    size: tuple[int, int] = SIZE
    seed: int = 0

    def __post_init__(self) -> None:
        if not MIN_PHOTOGRAPHS <= self.photographs <= MAX_PHOTOGRAPHS:
            raise InputError(
                f"--photographs {self.photographs}: give a whole number from {MIN_PHOTOGRAPHS} to {MAX_PHOTOGRAPHS}"
            )
        width, height = self.size
        if not all(MIN_SIDE <= side <= MAX_SIDE for side in self.size) or max(self.size) > _NARROW * min(self.size):
            raise InputError(
                f"--size {width}x{height}: give sides of {MIN_SIDE} to {MAX_SIDE} pixels, the longer at most"
                f" {_NARROW} times the shorter"
            )


@dataclass(frozen=True)
class Step:
    """One step of the work. what: name of the step. done: fraction 0…1 of the work before it."""

    what: str
    done: float


def sample_steps(request: Request, folder: Path, samples: int = _SAMPLES) -> Generator[Step, None, layout.Layout]:
    """Write photographs and truth into a new folder, whole or not at all; yield before each render.

    samples: of Cycles per pixel of a photograph. Returns the layout. Raises InputError if the folder is not empty or
    cannot be written. The open file's scenes do not change. Same request, samples and machine: same bytes.
    """
    check_unused(folder)
    arrangement = layout.make_layout(request.size, request.photographs, request.seed)
    steps = request.photographs + 2
    yield Step("building", 0.0)
    with new_folder(folder) as partial, table_top.own_scene(_SCENE) as scene:
        rendered = partial / ".rendered.exr"
        _build(scene, arrangement)
        yield Step("truth", 1 / steps)
        cycles.set_up(scene, _view(request, _TRUTH_SAMPLES, bounces=0))
        cycles.render_maps(scene, rendered, more=(table_top.SUBJECT,))
        names = photograph_names(request.photographs)
        write_truth(partial, arrangement, cycles.read_seen_maps(rendered, more=(table_top.SUBJECT,)), names)
        cycles.set_up(scene, _view(request, samples, _BOUNCES))
        scene.cycles.seed = request.seed % 2**31
        lamp = cycles.only_lamp(scene, "POINT", layout.LAMP_RADIUS)
        (partial / FOLDER).mkdir()
        for number, (name, place) in enumerate(zip(names, arrangement.lamps, strict=True)):
            yield Step(f"photograph {number + 1} of {len(names)}", (number + 2) / steps)
            cycles.place_lamp(lamp, place, layout.LAMP_DISTANCE)
            cycles.render_radiance(scene, rendered)
            noise = np.random.SeedSequence([request.seed % 2**32, number]).generate_state(1)[0]
            codes = developed(cycles.read_radiance(rendered), int(noise))
            write_photograph(partial / FOLDER / name, codes, layout.FOCAL_35MM)
        rendered.unlink()
    return arrangement


def photograph_names(count: int) -> list[str]:
    """Return the file names of the photographs, in order."""
    return [f"IMG_{number:04d}.jpg" for number in range(1, count + 1)]


def _view(request: Request, samples: int, bounces: int) -> cycles.View:
    # Low clamp: the lamp causes fireflies on the ball, which a photograph of this size does not resolve.
    return cycles.View(*request.size, samples=samples, bounces=bounces, clamp=1.0)


def _build(scene: object, arrangement: layout.Layout) -> None:
    """Add camera, table, tile, ball and chart to the scene."""
    table_top.add_camera(scene, arrangement.camera)
    table_top.add_room(scene, _TABLE)
    across = 2 * HALF * arrangement.camera.scale[0] / arrangement.card_distance  # pixels
    count = int(np.clip(_QUADS * across, _MIN_QUADS, _MAX_QUADS)) + 1
    along = np.linspace(-HALF, HALF, count)
    corners = tile(*np.meshgrid(along, along))
    # Texels are at the centres of the grid's quads, vertices at their corners.
    centres = (along[1:] + along[:-1]) / 2
    surface = tile(*np.meshgrid(centres, centres))
    maps = TrueMaps(surface.base_color, None, surface.roughness, surface.metallic)
    table_top.add_relief(scene, corners.height, maps, layout.TILE, HALF)
    table_top.add_print(scene, chart_picture(), layout.CHART, (WIDE, TALL), layout.CHART_THICKNESS)
    table_top.add_ball(scene, layout.ball_middle(), layout.BALL_RADIUS)
