"""Parsers of the commands that make a capture of photographs, or check it."""

from __future__ import annotations

import argparse

from .shared import COLOUR_SPACE, EPILOG, SKIP_DAMAGED, add_common, add_distance, add_mesh, part

_EXPOSURES = "exposures, in seconds, of names that end in _0, _1, …, as in 1/60,1/15,1/4"


def add_inspect(commands: argparse._SubParsersAction) -> None:
    """Add the command ``inspect``."""
    add = commands.add_parser("inspect", help="list the contents of a capture and its faults", epilog=EPILOG)
    add.add_argument("capture", help="folder, .lp file or capture.toml")
    add.add_argument("--colour-space", choices=("auto", "srgb", "linear"), default="auto", help=COLOUR_SPACE)
    add_distance(add)
    add.add_argument("--skip-damaged", action="store_true", help=SKIP_DAMAGED)
    add_common(add)


def add_calibrate(commands: argparse._SubParsersAction) -> None:
    """Add the command ``calibrate``."""
    add = commands.add_parser("calibrate", help="find the lights of photographs by balls or the subject", epilog=EPILOG)
    add.add_argument("capture", metavar="CAPTURE_OR_IMAGES",
                     help="folder of photographs or videos, a video, or a capture")  # fmt: skip
    add.add_argument("-o", "--output", required=True, metavar="OUT", help="new folder, or a new capture.toml")
    add.add_argument("--replace", action="store_true", help="replace the files of a former calibration in OUT")
    add.add_argument("--count", type=int, metavar="N", help="largest number of frames of a video (default 40)")
    add.add_argument("--ball", action="append", metavar="auto|none|MASK|X,Y,R",
                     help="auto (the default): find the balls; none: find the lights from the subject's own shading;"
                     " MASK: image that is white on the ball; X,Y,R: centre and radius of the ball, or points of its"
                     " outline, X1,Y1,X2,Y2,X3,Y3,…, in pixels from the upper left corner; may be"
                     " repeated")  # fmt: skip
    add.add_argument("--inside-out", action="store_true",
                     help="with --ball none: use the other possible relief, if the first looks inside out")  # fmt: skip
    add.add_argument(
        "--flat", action="store_true", help="with --ball none: the subject is flat, and lamps stand near it"
    )
    add.add_argument(
        "--blend", metavar="FILE", help="with --ball none: Blender file with the subject's mesh, whose shape is known"
    )
    add_mesh(add)
    add.add_argument("--kind", default="auto", choices=("auto", "mirror", "matte"),
                     help="kind of all balls (default auto, which needs --ball auto)")  # fmt: skip
    add.add_argument("--fov", type=float, metavar="DEGREES", help="the camera's full angle over the image's width")
    add.add_argument("--camera", metavar="FILE", help="camera.toml, instead of --fov")
    add.add_argument("--view", metavar="NAME", help="camera that saw the balls, if the capture has several")
    add.add_argument("--radius", type=float, metavar="R",
                     help="radius of the balls, in the unit of light positions (default: 1)")  # fmt: skip
    add.add_argument(
        "--lights", choices=("auto", "distant", "near"), default="auto", help="kind of lights (default auto)"
    )
    add.add_argument("--lamp-distance", "--distance", type=float, metavar="D",
                     help="known distance from the balls to all lights, in the unit of --radius")  # fmt: skip
    add.add_argument("--albedo", metavar="A|R,G,B",
                     help="albedo of matte balls (default: intensities are relative to the first light)")  # fmt: skip
    add.add_argument("--colour-space", choices=("auto", "srgb", "linear"), default="auto", help=COLOUR_SPACE)
    add_common(add)


def add_develop(commands: argparse._SubParsersAction) -> None:
    """Add the command ``develop``."""
    add = commands.add_parser("develop", help="make linear images from camera files, one per light", epilog=EPILOG)
    add.add_argument("capture", help="capture, or folder of photographs")
    add.add_argument("-o", "--output", required=True, metavar="OUT", help="new folder for the images and lists")
    add.add_argument("--response", metavar="FILE", help="response curve that irpso response wrote, or a .csv")
    add.add_argument("--grey-card", action="append", metavar="auto|X,Y,W,H=R",
                     help="grey patch of known reflectance R, to measure the response curve; give two or more; auto:"
                     " find the 24-patch chart and use its grey row")  # fmt: skip
    add.add_argument(
        "--chart", metavar="FILE", help="photograph with the patches or the colour chart (default: the first)"
    )
    add.add_argument("--dark", nargs="+", metavar="FILE", help="dark frames, files or folders")
    add.add_argument("--scale-dark", action="store_true", help="scale dark frames to exposures for which there is none")
    add.add_argument("--flat", nargs="+", metavar="FILE", help="flat fields, files or folders")
    add.add_argument("--white", metavar="auto|X,Y,W,H",
                     help="white balance from a grey patch; =R, its reflectance, also sets the scale; auto: find a grey"
                     " card; or the gains R,G,B of the three channels")  # fmt: skip
    add.add_argument("--colour-chart", metavar="auto|X1,Y1,…,X4,Y4",
                     help="colours and scale from a 24-patch chart: auto finds it; or the corners of its patches,"
                     " clockwise from that of dark skin")  # fmt: skip
    add.add_argument("--brackets", choices=("exif", "names"), help="merge the exposures of each light")
    add.add_argument("--bursts", choices=("exif", "pictures"),
                     help="average the photographs of each light, grouped by their times or by likeness")  # fmt: skip
    add.add_argument(
        "--exposure", choices=("exif", "names"), help="scale each photograph by its exposure, and merge none"
    )
    add.add_argument("--exposures", metavar="A,B,…", help=_EXPOSURES)
    add.add_argument("--saturated", type=part, default=0.98, metavar="S",
                     help="merging ignores pixels from this part of the largest code on (default 0.98)")  # fmt: skip
    add.add_argument("--register", action="store_true", help="shift images onto one of them")
    add.add_argument("--reference", metavar="NAME", help="image that the others are shifted onto (default: the first)")
    add.add_argument("--colour-space", choices=("auto", "srgb", "linear"), default="auto", help=COLOUR_SPACE)
    add.add_argument("--half", action="store_true", help="write 16-bit floats")
    add_common(add)


def add_response(commands: argparse._SubParsersAction) -> None:
    """Add the command ``response``."""
    add = commands.add_parser(
        "response", help="measure a camera's response curve from brackets or a chart", epilog=EPILOG
    )
    add.add_argument("photographs", help="folder of brackets; with --grey-card: a photograph")
    add.add_argument("-o", "--output", required=True, metavar="FILE", help=".toml file for the curve")
    add.add_argument("--brackets", choices=("exif", "names"), help="where exposures are read from (default exif)")
    add.add_argument("--exposures", metavar="A,B,…", help=_EXPOSURES)
    add.add_argument("--grey-card", action="append", metavar="auto|X,Y,W,H=R",
                     help="grey patch of known reflectance R; give two or more; auto: find the 24-patch chart and use"
                     " its grey row")  # fmt: skip
    add_common(add)


def add_rig(commands: argparse._SubParsersAction) -> None:
    """Add the command ``rig``."""
    add = commands.add_parser(
        "rig", help="keep lamps, cameras and corrections; apply them to new photographs", epilog=EPILOG
    )
    add.add_argument("action", choices=("save", "apply"), help="save those of a capture, or apply those of a rig")
    add.add_argument("inputs", nargs="+", metavar="CAPTURE|RIG PHOTOGRAPHS",
                     help="save: a capture; apply: a rig, and the folder of the photographs")  # fmt: skip
    add.add_argument("-o", "--output", required=True, metavar="OUT", help="new folder for the rig, or the capture")
    add.add_argument("--match", choices=("auto", "order", "names", "numbers"), default="auto",
                     help="how lamps are matched to photographs (auto: by equal names, else by order)")  # fmt: skip
    add.add_argument("--exposure", choices=("exif",), help="scale photographs of another exposure to that of the rig")
    add.add_argument("--half", action="store_true", help="write developed images as 16-bit floats")
    add_common(add)


def add_frames(commands: argparse._SubParsersAction) -> None:
    """Add the command ``frames``."""
    add = commands.add_parser(
        "frames", help="choose photographs from a video of a lamp carried around a subject", epilog=EPILOG
    )
    add.add_argument("videos", nargs="+", metavar="VIDEO", help="video of a still camera; several: of the same")
    add.add_argument("-o", "--output", required=True, metavar="FOLDER", help="new folder for the photographs")
    add.add_argument("--count", type=int, metavar="N", help="largest number of photographs (default 40)")
    add_common(add)


def add_markers(commands: argparse._SubParsersAction) -> None:
    """Add the command ``markers``."""
    add = commands.add_parser("markers", help="write a marker board to print and to lay around a card", epilog=EPILOG)
    add.add_argument("-o", "--output", required=True, metavar="BOARD", help="the file: .pdf or .png")
    add.add_argument("--paper", choices=("A4", "letter"), default="A4", help="size of the paper (default A4)")
    add.add_argument("--count", type=int, choices=(4, 8), default=8, help="number of markers (default 8)")
    add_common(add)


def add_handheld(commands: argparse._SubParsersAction) -> None:
    """Add the command ``handheld``."""
    add = commands.add_parser(
        "handheld", help="find cameras and lights of photographs taken by hand, with the phone's flash", epilog=EPILOG
    )
    add.add_argument("photographs", metavar="PHOTOS", help="folder of photographs, 30 or more, of one flat card")
    add.add_argument("-o", "--output", required=True, metavar="CAPTURE", help="new folder")
    add.add_argument("--fov", type=float, metavar="DEGREES",
                     help="the camera's full angle over the image's width (default: that of camera.toml;"
                     " or EXIF's, refined)")  # fmt: skip
    add.add_argument("--flash-offset", metavar="X,Y,Z",
                     help="place of the flash relative to the lens in millimetres: to the right, up, toward you, in a"
                     " picture without EXIF rotation (default: found from the brightness)")  # fmt: skip
    add.add_argument("--colour-space", choices=("auto", "srgb", "linear"), default="auto", help=COLOUR_SPACE)
    add_common(add)
