"""The parser of the command line."""

from __future__ import annotations

import argparse
import re
from typing import Any, NoReturn

from ..core.errors import InputError
from ..core.paths import DEFAULT_MODEL
from ..exports.names import ASSET, FORMATS, RELIEF, TURNTABLE
from . import photographs
from .shared import COLOUR_SPACE, EPILOG, SKIP_DAMAGED, add_common, add_distance, add_mesh, add_shelf, seed

_MODEL = f"shipped model, or your own .toml (default {DEFAULT_MODEL})"
_ENTRY = "kind of GPU pass (default auto: the one that irpso doctor reports)"
_MISSING_VALUE = re.compile(r"(--[\w-]+): expected one argument")


class _Parser(argparse.ArgumentParser):
    """A parser that reports an error as one line, like all bad input, and accepts no abbreviated options."""

    def __init__(self, *words: Any, **settings: Any):
        super().__init__(*words, **settings, allow_abbrev=False)

    def error(self, message: str) -> NoReturn:
        """Raise InputError instead of printing the usage and ending the process, which may be Blender."""
        missing = _MISSING_VALUE.search(message)
        remedy = f"; write {missing[1]}=VALUE if the value begins with -" if missing else ""
        raise InputError(f"{message}{remedy}; see {self.prog} --help")


def build_parser() -> argparse.ArgumentParser:
    """Return the parser with all commands."""
    parser = _Parser("irpso", description="Recovers materials from photographs.", epilog=EPILOG)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    _add_recover(commands)
    _add_batch(commands)
    _add_export(commands)
    _add_render(commands)
    photographs.add_inspect(commands)
    photographs.add_calibrate(commands)
    photographs.add_develop(commands)
    photographs.add_response(commands)
    photographs.add_rig(commands)
    photographs.add_frames(commands)
    _add_sample(commands)
    _add_tile(commands)
    photographs.add_markers(commands)
    photographs.add_handheld(commands)
    _add_demo(commands)
    add = commands.add_parser(
        "doctor", help="check the GPU: its limits, and the kind of passes that will be used", epilog=EPILOG
    )
    add.add_argument(
        "--benchmark", action="store_true", help="also recover a rendered card, and print the speed of each phase"
    )
    add_common(add)
    return parser


def _add_recover(commands: argparse._SubParsersAction) -> None:
    add = commands.add_parser("recover", help="recover maps and a material from a capture", epilog=EPILOG)
    add.add_argument("capture", help="folder, .lp file, capture.toml, or .blend whose lights have photographs")
    add.add_argument("-o", "--output", required=True, metavar="OUT", help="folder for the result")
    add.add_argument("--blend", metavar="FILE", help="Blender file with the mesh (default: the subject is a flat card)")
    add_mesh(add, "; each: all, one by one")
    add.add_argument("--resolution", metavar="N", help="texels of a UV square or UDIM tile: N or WxH (default 512)")
    add.add_argument("--no-shadows", dest="shadows", action="store_false",
                     help="do not predict the shadows that the mesh casts on itself")  # fmt: skip
    add.add_argument("--fixed", action="append", default=[], metavar="NAME=VALUE",
                     help="fix a parameter to an EXR file, or to numbers, as in base_color=0.5,0.5,0.5")  # fmt: skip
    add.add_argument("--ground-truth", metavar="FILE", help="EXR with the true maps, to measure errors against")
    add.add_argument(
        "--hold-out",
        metavar="auto|NAME,…",
        help="leave photographs (by name, or by number from 0) out of the fit, and relight them; auto: one in eight,"
        " six at most",
    )
    _add_framing(add)
    add.add_argument(
        "--intensities",
        choices=("auto", "given", "estimate"),
        default="auto",
        help="light intensities: as given; estimated up to one scale; auto (the default): estimated if the capture has"
        " none and the images contradict equal ones",
    )
    add.add_argument("--refine-directions", type=float, default=0.0, metavar="DEGREES",
                     help="correct light directions, whose typical error (standard deviation) is DEGREES, 0 to 20"
                     " (default 0: keep them)")  # fmt: skip
    _add_result(add)
    _add_run(add)
    _add_solver(add)
    add_common(add)


def _add_framing(add: argparse.ArgumentParser) -> None:
    """Add the options of how photographs are read and which part of a card is recovered."""
    add.add_argument("--colour-space", choices=("auto", "srgb", "linear"), default="auto", help=COLOUR_SPACE)
    add_distance(add)
    add.add_argument(
        "--crop", metavar="X,Y,W,H", help="part of a card's pictures, in pixels from the upper left corner"
    )
    add.add_argument("--corners", metavar="auto|X1,Y1,…,X4,Y4",
                     help="corners of a flat rectangle, clockwise from its upper left one: it is recovered as seen"
                     " straight from the front; auto: find them, by printed markers or as the only"
                     " rectangle")  # fmt: skip
    add.add_argument(
        "--scale", type=float, metavar="S", help="size of the pictures, 0.25 for a quick preview (default 1)"
    )
    add.add_argument("--skip-damaged", action="store_true", help=SKIP_DAMAGED)


def _add_result(add: argparse.ArgumentParser) -> None:
    """Add the options of what is written beside the maps."""
    add.add_argument("--normals", metavar="A,B", help="write more normal maps: object, world, directx")
    add.add_argument("--height", action="store_true", help="also integrate the normals to a relief")
    add.add_argument("--displacement", action="store_true",
                     help="also displace the material's surface by the relief (implies --height)")  # fmt: skip
    add.add_argument(
        "--asset", metavar="LIBRARY", help="also save the material to this folder, a Blender asset library"
    )
    add_shelf(add)


def _add_run(add: argparse.ArgumentParser) -> None:
    """Add the options of the run: checkpoints, previews, memory."""
    add.add_argument(
        "--resume", action="store_true", help="continue from the checkpoint that an interrupted run left in OUT"
    )
    add.add_argument("--checkpoint-every", type=float, metavar="SECONDS",
                     help="write a checkpoint into OUT at this interval, for --resume")  # fmt: skip
    add.add_argument(
        "--preview",
        action=argparse.BooleanOptionalAction,
        help="first write maps of a quarter of each side into OUT/preview (default: if the whole is expected to take"
        " more than 20 minutes)",
    )
    add.add_argument("--live", action="store_true", help="keep updating OUT/live.png, a picture of the maps so far")
    add.add_argument("--memory", metavar="SIZE", help="largest memory to use, as 4G or device=4G,host=8G")
    add.add_argument(
        "--dry-run",
        action="store_true",
        help="print the plan of tiles and memory, and the search time; read no image, write nothing",
    )


def _add_batch(commands: argparse._SubParsersAction) -> None:
    add = commands.add_parser("batch", help="run a list of recoveries; restartable", epilog=EPILOG)
    add.add_argument("list", help=".toml file with a [[job]] per recovery")
    add.add_argument("-o", "--output", required=True, metavar="OUT", help="folder for the results, one per job")
    add.add_argument("--only", metavar="NAME", help="run only this job, as the task of a render farm")
    add.set_defaults(parse=lambda words: build_parser().parse_args(words))
    add_common(add)


def _add_solver(add: argparse.ArgumentParser) -> None:
    add.add_argument("--model", default=DEFAULT_MODEL, metavar="M", help=_MODEL)
    add.add_argument(
        "--preset", default="standard", metavar="P", help="shipped preset, or your own .toml (default standard)"
    )
    add.add_argument("--set", action="append", default=[], metavar="NAME=VALUE",
                     help="change one setting of the preset, as in --set particles=12 --set start=random")  # fmt: skip
    add.add_argument("--search", metavar="A,B", help="search only these parameters or stages, together")
    add.add_argument("--iterations", type=int, metavar="N", help="iterations of every stage (default: the preset's)")
    add.add_argument("--seed", type=seed, default=0, metavar="S", help="seed of the random numbers (default 0)")
    add.add_argument("--entry", choices=("auto", "fragment", "compute"), default="auto", help=_ENTRY)


def _add_export(commands: argparse._SubParsersAction) -> None:
    add = commands.add_parser("export", help="write a result for other programs", epilog=EPILOG)
    add.add_argument("result", help="folder that recover wrote")
    add.add_argument(
        "-o", "--output", required=True, metavar="OUT", help="folder, or a .glb, .ptm, .stl, .ply, .obj or .png file"
    )
    add.add_argument(
        "--format",
        required=True,
        choices=[*FORMATS, RELIEF, TURNTABLE, ASSET],
        help="format to write; OUT of asset is a Blender asset library",
    )
    add.add_argument("--convention", choices=("blender", "unreal", "unity", "substance"),
                     help="names and normals of textures (default blender)")  # fmt: skip
    add.add_argument(
        "--object", metavar="NAME", help="mesh object of gltf, turntable and asset, if several have recovered materials"
    )
    add.add_argument("--occlusion", action="store_true",
                     help="add occlusion to gltf and textures: from a card's relief, for a mesh by Cycles")  # fmt: skip
    add.add_argument("--rays", type=int, metavar="N", help="rays per texel for a mesh's occlusion (default 128)")
    add.add_argument("--occluder", action="append", default=[], metavar="NAME",
                     help="object in the result's .blend that hides the mesh's sky; may be repeated")  # fmt: skip
    add.add_argument("--width", type=float, metavar="W",
                     help="width of a card exported as relief (default 100, for millimetres)")  # fmt: skip
    add.add_argument("--photographs", type=int, metavar="N",
                     help="number of photographs in a web page: held-out ones, then the most different"
                     " (default 8)")  # fmt: skip
    add.add_argument("--replace", action="store_true",
                     help="replace files of the same names; an asset is never replaced")  # fmt: skip
    add_shelf(add)
    add.add_argument("--model", metavar="M", help="the model's .toml, if it has moved since the recovery")
    add_common(add)


def _add_render(commands: argparse._SubParsersAction) -> None:
    add = commands.add_parser("render", help="render a capture from maps, a mesh and lights", epilog=EPILOG)
    add.add_argument("maps", help="folder of a result, or an EXR with maps")
    add.add_argument("-o", "--output", required=True, metavar="CAPTURE", help="folder for the capture")
    add.add_argument("--blend", required=True, metavar="FILE", help="Blender file with mesh and cameras")
    add.add_argument("--object", metavar="NAME", help="mesh object, if FILE has several")
    add.add_argument("--camera", action="append", default=[], metavar="NAME",
                     help="camera object; may be repeated (default: the scene's active camera)")  # fmt: skip
    add.add_argument("--size", default="512x512", metavar="WxH", help="size of the images in pixels (default 512x512)")
    add.add_argument("--dome", default="10x20", metavar="LATxLON",
                     help="distant lights, evenly over the sphere (default 10x20, as in the paper)")  # fmt: skip
    add.add_argument("--lights", metavar="FILE", help="file of light directions, x y z on each line, instead of a dome")
    add.add_argument("--model", metavar="M",
                     help=f"the model of the maps (default: the result's, of other maps {DEFAULT_MODEL})")  # fmt: skip
    add_common(add)


def _add_sample(commands: argparse._SubParsersAction) -> None:
    add = commands.add_parser("sample", help="render a capture to practise on: photographs and truth", epilog=EPILOG)
    add.add_argument("-o", "--output", required=True, metavar="DIR", help="new folder for photographs and truth")
    add.add_argument("--photographs", type=int, metavar="N", help="number of photographs (default 16)")
    add.add_argument("--size", metavar="WxH", help="size of the photographs in pixels (default 640x480)")
    add.add_argument("--seed", type=seed, default=0, metavar="S",
                     help="seed of the lamp positions and of the noise (default 0)")  # fmt: skip
    add_common(add)


def _add_tile(commands: argparse._SubParsersAction) -> None:
    add = commands.add_parser("tile", help="make a card's result repeat without a seam", epilog=EPILOG)
    add.add_argument("result", help="folder that recover wrote for a card")
    add.add_argument("-o", "--output", required=True, metavar="OUT", help="folder for the result that repeats")
    add.add_argument(
        "--size",
        type=int,
        metavar="N",
        help="texels along a side (default: the largest power of two that needs no enlarging)",
    )
    add.add_argument("--overlap", type=float, metavar="SHARE",
                     help="width of the joint as a part of the side (default: best of 0.2 to 0.4)")  # fmt: skip
    add.add_argument("--model", metavar="M", help="the model's .toml, if it has moved since the recovery")
    add_common(add)


def _add_demo(commands: argparse._SubParsersAction) -> None:
    add = commands.add_parser("demo", help="run the paper's experiment, from rendering to material", epilog=EPILOG)
    add.add_argument("-o", "--output", default="out/paper", metavar="OUT",
                     help="folder for the result (default out/paper)")  # fmt: skip
    add.add_argument("--quick", action="store_true", help="small sizes: under three minutes on two CPU cores")
    add.add_argument("--preset", default="swarm", metavar="P", help="shipped preset, or your own .toml (default swarm)")
    add.add_argument("--seed", type=seed, default=0, metavar="S", help="seed of the random numbers (default 0)")
    add.add_argument("--entry", choices=("auto", "fragment", "compute"), default="auto", help=_ENTRY)
    add_common(add)
