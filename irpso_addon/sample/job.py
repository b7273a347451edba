"""One sample, from options to files. The command line and the window share it."""

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
FEWEST, MOST = 3, 200  # photographs
SMALLEST, LARGEST = 80, 4096  # pixels of a side
_NARROW = 3  # longer over shorter side, at most
FOLDER = "photographs"
_SAMPLES, _TRUTH_SAMPLES, _BOUNCES = 8, 32, 2
_QUADS = 1.5  # of the tile's mesh, to a pixel along a side
_FEWEST_QUADS, _MOST_QUADS = 600, 1600
_TABLE = 4000.0  # millimetres
_SCENE = "IRPSO sample"


@dataclass(frozen=True)
class Request:
    """photographs: how many. size: width and height in pixels. seed: of the lamp's places and of all noise.

    Raises InputError at numbers out of range.
    """

    photographs: int = PHOTOGRAPHS
    size: tuple[int, int] = SIZE
    seed: int = 0

    def __post_init__(self) -> None:
        if not FEWEST <= self.photographs <= MOST:
            raise InputError(f"--photographs {self.photographs}: give a whole number from {FEWEST} to {MOST}")
        width, height = self.size
        if not all(SMALLEST <= side <= LARGEST for side in self.size) or max(self.size) > _NARROW * min(self.size):
            raise InputError(
                f"--size {width}x{height}: give sides of {SMALLEST} to {LARGEST} pixels, the longer at most"
                f" {_NARROW} times the shorter"
            )


@dataclass(frozen=True)
class Step:
    """What is about to be done, and the share (0…1) of the work that is done."""

    what: str
    done: float


def sample_steps(request: Request, folder: Path, samples: int = _SAMPLES) -> Generator[Step, None, layout.Layout]:
    """Yield before each render; write photographs and truth into a new folder, whole or not at all.

    samples: of Cycles, for each pixel of a photograph. Returns the layout. Raises InputError if the folder is not empty
    or cannot be written. The open file's scenes stay as they are. Same request, samples and machine: same bytes.
    """
    check_unused(folder)
    found = layout.arranged(request.size, request.photographs, request.seed)
    steps = request.photographs + 2
    yield Step("building", 0.0)
    with new_folder(folder) as partial, table_top.own_scene(_SCENE) as scene:
        rendered = partial / ".rendered.exr"
        _build(scene, found)
        yield Step("truth", 1 / steps)
        cycles.set_up(scene, _view(request, _TRUTH_SAMPLES, bounces=0))
        cycles.render_maps(scene, rendered, more=(table_top.SUBJECT,))
        names = photograph_names(request.photographs)
        write_truth(partial, found, cycles.read_seen_maps(rendered, more=(table_top.SUBJECT,)), names)
        cycles.set_up(scene, _view(request, samples, _BOUNCES))
        scene.cycles.seed = request.seed % 2**31
        lamp = cycles.only_lamp(scene, "POINT", layout.LAMP_RADIUS)
        (partial / FOLDER).mkdir()
        for number, (name, place) in enumerate(zip(names, found.lamps, strict=True)):
            yield Step(f"photograph {number + 1} of {len(names)}", (number + 2) / steps)
            cycles.place_lamp(lamp, place, layout.LAMP_DISTANCE)
            cycles.render_radiance(scene, rendered)
            noise = np.random.SeedSequence([request.seed % 2**32, number]).generate_state(1)[0]
            codes = developed(cycles.read_radiance(rendered), int(noise))
            write_photograph(partial / FOLDER / name, codes, layout.FOCAL_35MM)
        rendered.unlink()
    return found


def photograph_names(count: int) -> list[str]:
    """Return the names of the photographs, in the order in which they are taken."""
    return [f"IMG_{number:04d}.jpg" for number in range(1, count + 1)]


def _view(request: Request, samples: int, bounces: int) -> cycles.View:
    # A cautious clamp: the ball throws sparks of the lamp's light, which a photograph this size does not resolve.
    return cycles.View(*request.size, samples=samples, bounces=bounces, clamp=1.0)


def _build(scene: object, found: layout.Layout) -> None:
    """Put camera, table, tile, ball and chart into the scene."""
    table_top.add_camera(scene, found.camera)
    table_top.add_room(scene, _TABLE)
    across = 2 * HALF * found.camera.scale[0] / found.card_distance  # pixels
    count = int(np.clip(_QUADS * across, _FEWEST_QUADS, _MOST_QUADS)) + 1
    along = np.linspace(-HALF, HALF, count)
    corners = tile(*np.meshgrid(along, along))
    # Textures have their texels at the middles of the grid's quads, vertices at its corners.
    middles = (along[1:] + along[:-1]) / 2
    painted = tile(*np.meshgrid(middles, middles))
    maps = TrueMaps(painted.base_color, None, painted.roughness, painted.metallic)
    table_top.add_relief(scene, corners.height, maps, layout.TILE, HALF)
    table_top.add_print(scene, chart_picture(), layout.CHART, (WIDE, TALL), layout.CHART_THICKNESS)
    table_top.add_ball(scene, layout.ball_middle(), layout.BALL_RADIUS)
