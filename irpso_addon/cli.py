"""Command line: one parser for ``blender --command irpso …`` and ``python -m irpso_addon …``."""

from __future__ import annotations

import argparse
import json
import signal
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Any, NoReturn

from .core.errors import InputError, IrpsoError, ShaderError
from .core.paths import DEFAULT_MODEL
from .exports.names import FORMATS

INTERRUPTED = 130  # the shell's own code for a program ended by Ctrl-C
_ZIP = "install the extension from the zip that `make extension` builds, which holds it, or {} with pip"
_REMEDIES = {  # for a missing module
    "numpy": "install numpy (for Debian's Blender: the package python3-numpy)",
    "OpenEXR": _ZIP.format("OpenEXR"),
    "PIL": _ZIP.format("Pillow"),
    "bpy": "install bpy with pip, or use an installed Blender",
}
_SKIP_DAMAGED = "leave out images that are missing or cannot be decoded, and list them"
_COLOUR_SPACE = "encoding of the image files (default auto: as stated or measured; else 8 bits sRGB, others linear)"
_MODEL = f"shipped model, or your own .toml (default {DEFAULT_MODEL})"
_ENTRY = "kind of GPU pass (default auto: as doctor says)"
_EXPOSURES = "exposures of _0, _1, … at the end of names, as in 1/60,1/15,1/4"
_EPILOG = "Exit codes: 0 done, 2 bad input (nothing written), 3 no usable GPU, 130 interrupted."


class _Parser(argparse.ArgumentParser):
    """A parser that reports an error as one line, like all bad input, and accepts no abbreviated options."""

    def __init__(self, *words: Any, **settings: Any):
        super().__init__(*words, **settings, allow_abbrev=False)

    def error(self, message: str) -> NoReturn:
        """Raise InputError instead of printing the usage and ending the process, which may be Blender."""
        raise InputError(f"{message}; see {self.prog} --help")


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code; a bad option returns 2, like any bad input."""
    argv = sys.argv[1:] if argv is None else list(argv)
    try:
        options = build_parser().parse_args(argv)
    except InputError as error:
        return _fail(error, "--json" in argv)
    except SystemExit as stop:  # --help; this process may be Blender
        return int(stop.code or 0)
    for number in (signal.SIGINT, signal.SIGTERM):  # Blender has its own SIGINT handler
        signal.signal(number, signal.default_int_handler)
    try:
        result = import_module(f".commands.{options.command}", __package__).run(options)
    except IrpsoError as error:
        return _fail(error, options.json)
    except ModuleNotFoundError as error:
        if error.name not in _REMEDIES:
            raise
        return _fail(InputError(f"Python has no module {error.name}; {_REMEDIES[error.name]}"), options.json)
    except MemoryError as error:
        text = f"memory is full ({error}); choose a smaller --resolution, or smaller or fewer images"
        return _fail(InputError(text), options.json)
    except KeyboardInterrupt as stop:
        sys.stderr.write(f"\nirpso: interrupted{f'; {stop}' if str(stop) else ''}\n")
        return INTERRUPTED
    if options.json:
        _print_json(result)
    return int(result.get("exit_code", 0))


def _fail(error: IrpsoError, as_json: bool) -> int:
    """Print the error in one line; the compiler's whole log goes only into the JSON."""
    text = error.summary if isinstance(error, ShaderError) else " ".join(str(error).splitlines())
    sys.stderr.write(f"irpso: {text}\n")
    if as_json:
        log = {"log": error.log} if isinstance(error, ShaderError) else {}
        _print_json({"error": text, "exit_code": error.exit_code, **log})
    return error.exit_code


def build_parser() -> argparse.ArgumentParser:
    """Return the parser with all commands."""
    parser = _Parser("irpso", description="Recovers materials from photographs.", epilog=_EPILOG)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    _add_recover(commands)
    _add_batch(commands)
    _add_export(commands)
    _add_render(commands)
    _add_inspect(commands)
    _add_calibrate(commands)
    _add_develop(commands)
    _add_response(commands)
    _add_rig(commands)
    _add_frames(commands)
    _add_sample(commands)
    _add_markers(commands)
    _add_handheld(commands)
    _add_demo(commands)
    add = commands.add_parser("doctor", help="check the GPU: its limits, and the kind of passes that will be used")
    _add_common(add)
    return parser


def _add_recover(commands: argparse._SubParsersAction) -> None:
    add = commands.add_parser("recover", help="recover maps and a material from a capture", epilog=_EPILOG)
    add.add_argument("capture", help="folder, .lp file, capture.toml, or .blend whose lights have photographs")
    add.add_argument("-o", "--output", required=True, metavar="OUT", help="folder for the result")
    add.add_argument("--blend", metavar="FILE", help="Blender file with the mesh (default: the subject is a flat card)")
    _add_mesh(add, "; each: all, one by one")
    add.add_argument("--resolution", metavar="N", help="texels of a UV square or UDIM tile: N or WxH (default 512)")
    add.add_argument("--no-shadows", dest="shadows", action="store_false",
                     help="do not predict the shadows that the mesh casts on itself")  # fmt: skip
    add.add_argument("--fixed", action="append", default=[], metavar="NAME=VALUE",
                     help="fix a parameter to an EXR file, or to numbers, as in base_color=0.5,0.5,0.5")  # fmt: skip
    add.add_argument("--ground-truth", metavar="FILE", help="EXR with the true maps, to measure errors against")
    add.add_argument(
        "--hold-out",
        metavar="I,J,…",
        help="leave observations (counted from 0) out of the fit, and relight them; auto: one in eight, six at most",
    )
    add.add_argument("--colour-space", choices=("auto", "srgb", "linear"), default="auto", help=_COLOUR_SPACE)
    _add_distance(add)
    add.add_argument(
        "--crop", metavar="X,Y,W,H", help="part of a card's pictures, in pixels from the upper left corner"
    )
    add.add_argument("--corners", metavar="auto|X1,Y1,…,X4,Y4",
                     help="corners of a flat rectangle, clockwise from its upper left one: it is recovered as seen"
                     " straight from the front; auto: by printed markers, or the one rectangle that shows")  # fmt: skip
    add.add_argument(
        "--scale", type=float, metavar="S", help="size of the pictures, 0.25 for a quick preview (default 1)"
    )
    add.add_argument("--card-width", type=float, metavar="W",
                     help="width of the card as shown, in the unit of light positions; gives its distance")  # fmt: skip
    add.add_argument("--skip-damaged", action="store_true", help=_SKIP_DAMAGED)
    add.add_argument(
        "--intensities",
        choices=("auto", "given", "estimate"),
        default="auto",
        help="light intensities: as given; estimated up to one scale; auto (the default): estimated if the capture has"
        " none and the images contradict equal ones",
    )
    add.add_argument("--refine-directions", type=float, default=0.0, metavar="DEGREES",
                     help="correct light directions whose error is about DEGREES (default 0: keep them)")  # fmt: skip
    add.add_argument("--normals", metavar="A,B", help="write more normal maps: object, world, directx")
    add.add_argument("--height", action="store_true", help="also integrate the normals to a relief")
    add.add_argument("--displacement", action="store_true",
                     help="also displace the material's surface by the relief (implies --height)")  # fmt: skip
    add.add_argument(
        "--resume", action="store_true", help="continue from the checkpoint that an interrupted run left in OUT"
    )
    add.add_argument("--checkpoint-every", type=float, metavar="SECONDS",
                     help="write a checkpoint into OUT at this interval, for --resume")  # fmt: skip
    add.add_argument("--live", action="store_true", help="keep OUT/live.png, a picture of the maps so far")
    add.add_argument("--memory", metavar="SIZE", help="most memory to use, as 4G or device=4G,host=8G")
    add.add_argument(
        "--dry-run", action="store_true", help="print the plan of tiles and memory; read no image, write nothing"
    )
    _add_solver(add)
    _add_common(add)


def _add_batch(commands: argparse._SubParsersAction) -> None:
    add = commands.add_parser("batch", help="run a list of recoveries; restartable", epilog=_EPILOG)
    add.add_argument("list", help=".toml file with a [[job]] per recovery")
    add.add_argument("-o", "--output", required=True, metavar="OUT", help="folder for the results, one per job")
    add.add_argument("--only", metavar="NAME", help="run only this job, as the task of a render farm")
    add.set_defaults(parse=lambda words: build_parser().parse_args(words))
    _add_common(add)


def _add_solver(add: argparse.ArgumentParser) -> None:
    add.add_argument("--model", default=DEFAULT_MODEL, metavar="M", help=_MODEL)
    add.add_argument(
        "--preset", default="standard", metavar="P", help="shipped preset, or your own .toml (default standard)"
    )
    add.add_argument("--set", action="append", default=[], metavar="NAME=VALUE",
                     help="change one setting of the preset, as in --set particles=24 --set seed=random")  # fmt: skip
    add.add_argument("--search", metavar="A,B", help="search only these parameters or stages, together")
    add.add_argument("--iterations", type=int, metavar="N", help="iterations of every stage (default: the preset's)")
    add.add_argument("--seed", type=_seed, default=0, metavar="S", help="seed of the random numbers (default 0)")
    add.add_argument("--entry", choices=("auto", "fragment", "compute"), default="auto", help=_ENTRY)


def _add_distance(add: argparse.ArgumentParser) -> None:
    add.add_argument("--distance", type=float, metavar="D",
                     help="distance of a card from its camera; overrides card_distance of the capture")  # fmt: skip


def _add_export(commands: argparse._SubParsersAction) -> None:
    add = commands.add_parser("export", help="write a result for other programs", epilog=_EPILOG)
    add.add_argument("result", help="folder that recover wrote")
    add.add_argument("-o", "--output", required=True, metavar="OUT", help="folder, or a .glb or .ptm file")
    add.add_argument("--format", required=True, choices=list(FORMATS), help="format to write")
    add.add_argument("--convention", choices=("blender", "unreal", "unity", "substance"), default="blender",
                     help="names and normals of textures (default blender)")  # fmt: skip
    add.add_argument("--object", metavar="NAME", help="mesh object of gltf, if several have recovered materials")
    add.add_argument("--model", metavar="M", help="the model's .toml, if it has moved since the recovery")
    _add_common(add)


def _add_render(commands: argparse._SubParsersAction) -> None:
    add = commands.add_parser("render", help="render a capture from maps, a mesh and lights", epilog=_EPILOG)
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
    add.add_argument("--model", default=DEFAULT_MODEL, metavar="M", help=_MODEL)
    _add_common(add)


def _add_inspect(commands: argparse._SubParsersAction) -> None:
    add = commands.add_parser("inspect", help="list the contents of a capture and its faults", epilog=_EPILOG)
    add.add_argument("capture", help="folder, .lp file or capture.toml")
    add.add_argument("--colour-space", choices=("auto", "srgb", "linear"), default="auto", help=_COLOUR_SPACE)
    _add_distance(add)
    add.add_argument("--skip-damaged", action="store_true", help=_SKIP_DAMAGED)
    _add_common(add)


def _add_calibrate(commands: argparse._SubParsersAction) -> None:
    add = commands.add_parser("calibrate", help="find the lights of photographs from balls in them", epilog=_EPILOG)
    add.add_argument("capture", metavar="CAPTURE_OR_IMAGES", help="folder of photographs, or a capture")
    add.add_argument("-o", "--output", required=True, metavar="OUT", help="new folder, or a new capture.toml")
    add.add_argument("--ball", action="append", metavar="auto|none|MASK|X,Y,R",
                     help="auto (the default): balls are searched; none: the subject's own shading shows the lights;"
                     " image that is white on the ball; or centre and"
                     " radius; or points of the outline, X1,Y1,X2,Y2,X3,Y3,…; in pixels from the upper left corner; may"
                     " be repeated")  # fmt: skip
    add.add_argument("--inside-out", action="store_true",
                     help="with --ball none: the other of two answers, if the relief looks inside out")  # fmt: skip
    add.add_argument(
        "--flat", action="store_true", help="with --ball none: the subject is flat, and lamps stand near it"
    )
    add.add_argument(
        "--blend", metavar="FILE", help="with --ball none: Blender file with the subject's mesh, whose shape is known"
    )
    _add_mesh(add)
    add.add_argument("--kind", default="auto", choices=("auto", "mirror", "matte"),
                     help="kind of all balls (default auto, for balls that are searched)")  # fmt: skip
    add.add_argument("--fov", type=float, metavar="DEGREES", help="the camera's full angle over the image's width")
    add.add_argument("--camera", metavar="FILE", help="camera.toml, instead of --fov")
    add.add_argument("--view", metavar="NAME", help="camera that saw the balls, if the capture has several")
    add.add_argument("--radius", type=float, metavar="R",
                     help="radius of the balls in world units, the unit of light positions (default: 1)")  # fmt: skip
    add.add_argument(
        "--lights", choices=("auto", "distant", "near"), default="auto", help="kind of lights (default auto)"
    )
    add.add_argument("--distance", type=float, metavar="D",
                     help="known distance from the balls to all lights, in the unit of --radius")  # fmt: skip
    add.add_argument("--albedo", metavar="A|R,G,B",
                     help="albedo of matte balls (default: intensities are relative to the first light)")  # fmt: skip
    add.add_argument("--colour-space", choices=("auto", "srgb", "linear"), default="auto", help=_COLOUR_SPACE)
    _add_common(add)


def _add_mesh(add: argparse.ArgumentParser, more: str = "") -> None:
    add.add_argument("--object", metavar="NAME", help="mesh object in FILE")
    add.add_argument("--slots", metavar="A,B", help=f"use only these material slots, by name or by number from 0{more}")
    add.add_argument("--occluder", action="append", default=[], metavar="NAME",
                     help="object in FILE that hides and shades the mesh; may be repeated")  # fmt: skip


def _add_develop(commands: argparse._SubParsersAction) -> None:
    add = commands.add_parser("develop", help="make linear images from camera files, one per light", epilog=_EPILOG)
    add.add_argument("capture", help="capture, or folder of photographs")
    add.add_argument("-o", "--output", required=True, metavar="OUT", help="new folder for the images and lists")
    add.add_argument("--response", metavar="FILE", help="response curve that irpso response wrote, or a .csv")
    add.add_argument("--grey-card", action="append", metavar="X,Y,W,H=R",
                     help="grey patch of reflectance R, for a curve; give two or more")  # fmt: skip
    add.add_argument(
        "--chart", metavar="FILE", help="photograph with the patches or the colour chart (default: the first)"
    )
    add.add_argument("--dark", nargs="+", metavar="FILE", help="dark frames, files or folders")
    add.add_argument("--scale-dark", action="store_true", help="scale dark frames to exposures for which there is none")
    add.add_argument("--flat", nargs="+", metavar="FILE", help="flat fields, files or folders")
    add.add_argument("--white", metavar="X,Y,W,H",
                     help="white balance from a grey patch, with =R also the scale; or three gains R,G,B")  # fmt: skip
    add.add_argument("--colour-chart", metavar="auto|X1,Y1,…,X4,Y4",
                     help="colours and scale from a 24-patch chart: auto finds it; or the corners of its patches,"
                     " clockwise from that of dark skin")  # fmt: skip
    add.add_argument("--brackets", choices=("exif", "names"), help="merge the exposures of each light")
    add.add_argument(
        "--exposure", choices=("exif", "names"), help="scale each frame by its exposure, and merge nothing"
    )
    add.add_argument("--exposures", metavar="A,B,…", help=_EXPOSURES)
    add.add_argument("--saturated", type=_part, default=0.98, metavar="S",
                     help="merging ignores pixels from this part of the largest code (default 0.98)")  # fmt: skip
    add.add_argument("--register", action="store_true", help="shift images onto one of them")
    add.add_argument("--reference", metavar="NAME", help="image that the others are shifted onto (default: the first)")
    add.add_argument("--colour-space", choices=("auto", "srgb", "linear"), default="auto", help=_COLOUR_SPACE)
    add.add_argument("--half", action="store_true", help="write 16-bit floats")
    _add_common(add)


def _add_response(commands: argparse._SubParsersAction) -> None:
    add = commands.add_parser(
        "response", help="measure a camera's response curve from brackets or a chart", epilog=_EPILOG
    )
    add.add_argument("photographs", help="folder of brackets; with --grey-card: a photograph")
    add.add_argument("-o", "--output", required=True, metavar="FILE", help=".toml file for the curve")
    add.add_argument(
        "--brackets", choices=("exif", "names"), default="exif", help="where exposures are read from (default exif)"
    )
    add.add_argument("--exposures", metavar="A,B,…", help=_EXPOSURES)
    add.add_argument(
        "--grey-card", action="append", metavar="X,Y,W,H=R", help="grey patch of reflectance R; give two or more"
    )
    _add_common(add)


def _add_rig(commands: argparse._SubParsersAction) -> None:
    add = commands.add_parser(
        "rig", help="keep lamps, cameras and corrections; apply them to new photographs", epilog=_EPILOG
    )
    add.add_argument("action", choices=("save", "apply"), help="save a capture's, or apply a rig's")
    add.add_argument("inputs", nargs="+", metavar="CAPTURE|RIG PHOTOGRAPHS",
                     help="save: a capture; apply: a rig, and the folder of the photographs")  # fmt: skip
    add.add_argument("-o", "--output", required=True, metavar="OUT", help="new folder for the rig, or the capture")
    add.add_argument("--match", choices=("auto", "order", "names", "numbers"), default="auto",
                     help="how lamps are matched to photographs (auto: by equal names, else by order)")  # fmt: skip
    add.add_argument("--exposure", choices=("exif",), help="scale photographs of other exposures to the rig's")
    add.add_argument("--half", action="store_true", help="write developed images as 16-bit floats")
    _add_common(add)


def _add_frames(commands: argparse._SubParsersAction) -> None:
    add = commands.add_parser(
        "frames", help="choose photographs from a video of a lamp carried around a subject", epilog=_EPILOG
    )
    add.add_argument("video", help="video of a still camera")
    add.add_argument("-o", "--output", required=True, metavar="FOLDER", help="new folder for the photographs")
    add.add_argument("--count", type=int, metavar="N", help="most photographs (default 40)")
    _add_common(add)


def _add_sample(commands: argparse._SubParsersAction) -> None:
    add = commands.add_parser("sample", help="render a capture to practise on: photographs and truth", epilog=_EPILOG)
    add.add_argument("-o", "--output", required=True, metavar="DIR", help="new folder for photographs and truth")
    add.add_argument("--photographs", type=int, metavar="N", help="number of photographs (default 16)")
    add.add_argument("--size", metavar="WxH", help="size of the photographs in pixels (default 640x480)")
    add.add_argument("--seed", type=_seed, default=0, metavar="S",
                     help="seed of the lamp's places and of the noise (default 0)")  # fmt: skip
    _add_common(add)


def _add_markers(commands: argparse._SubParsersAction) -> None:
    add = commands.add_parser("markers", help="write a sheet of markers to print and to lay around a card")
    add.add_argument("-o", "--output", required=True, metavar="SHEET", help="the file: .pdf or .png")
    add.add_argument("--paper", choices=("A4", "letter"), default="A4", help="size of the paper (default A4)")
    add.add_argument("--count", type=int, choices=(4, 8), default=8, help="number of markers (default 8)")
    _add_common(add)


def _add_handheld(commands: argparse._SubParsersAction) -> None:
    add = commands.add_parser(
        "handheld", help="find cameras and lights of photographs taken by hand, with the phone's flash", epilog=_EPILOG
    )
    add.add_argument("photographs", metavar="PHOTOS", help="folder of photographs, 30 or more, of one flat card")
    add.add_argument("-o", "--output", required=True, metavar="CAPTURE", help="new folder")
    add.add_argument("--fov", type=float, metavar="DEGREES",
                     help="the camera's full angle over the image's width (default: by EXIF, and solved)")  # fmt: skip
    add.add_argument("--flash-offset", metavar="X,Y,Z",
                     help="place of the flash from the lens in millimetres: to the right, up, toward you (default:"
                     " found by the brightness)")  # fmt: skip
    add.add_argument("--colour-space", choices=("auto", "srgb", "linear"), default="auto", help=_COLOUR_SPACE)
    _add_common(add)


def _add_demo(commands: argparse._SubParsersAction) -> None:
    add = commands.add_parser("demo", help="run the paper's experiment, from rendering to material", epilog=_EPILOG)
    add.add_argument("-o", "--output", default="out/demo", metavar="OUT", help="folder for the result")
    add.add_argument("--quick", action="store_true", help="small sizes: under three minutes on two CPU cores")
    add.add_argument("--preset", default="swarm", metavar="P", help="shipped preset, or your own .toml (default swarm)")
    add.add_argument("--seed", type=_seed, default=0, metavar="S", help="seed of the random numbers (default 0)")
    add.add_argument("--entry", choices=("auto", "fragment", "compute"), default="auto", help=_ENTRY)
    _add_common(add)


def _add_common(add: argparse.ArgumentParser) -> None:
    add.add_argument("--json", action="store_true", help="print one line of JSON at the end")
    add.add_argument("--quiet", action="store_true", help="print no progress")


def _part(text: str) -> float:
    """Return a number above 0 and at most 1."""
    try:
        number = float(text)
    except ValueError:
        number = float("nan")
    if not 0 < number <= 1:
        raise argparse.ArgumentTypeError(f"{text}: give a number above 0 and at most 1")
    return number


def _seed(text: str) -> int:
    """Return a seed; shaders read it as a signed 32-bit integer."""
    try:
        number = int(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text} is not a whole number") from error
    if not -(2**31) <= number < 2**31:
        raise argparse.ArgumentTypeError(f"{text} does not fit 32 bits; give a whole number of up to nine digits")
    return number


def _print_json(value: dict) -> None:
    sys.stdout.write(json.dumps(value) + "\n")
