"""Options and help texts that several commands share."""

from __future__ import annotations

import argparse

SKIP_DAMAGED = "leave out images that are missing or cannot be decoded, and list them"
COLOUR_SPACE = (
    "encoding of the image files (default auto: as files state or pixels show; else sRGB for 8 bits, linear for others)"
)
EPILOG = (
    "Exit codes: 0 done; 2 bad input (nothing written), a finding of inspect, or a failed job of batch (the others are"
    " written); 3 no usable GPU; 130 interrupted."
)


def add_common(add: argparse.ArgumentParser) -> None:
    """Add the options of all commands."""
    add.add_argument("--json", action="store_true", help="print one line of JSON at the end")
    add.add_argument(
        "--quiet",
        action="store_true",
        help="print no progress and no summary, only warnings, errors and what inspect and doctor find",
    )


def add_distance(add: argparse.ArgumentParser) -> None:
    """Add the distance of a card, or its width."""
    add.add_argument("--distance", type=float, metavar="D",
                     help="distance of a card from its camera; overrides card_distance of the capture")  # fmt: skip
    add.add_argument("--card-width", type=float, metavar="W",
                     help="width of the card as shown, in the unit of light positions; gives its distance")  # fmt: skip


def add_mesh(add: argparse.ArgumentParser, more: str = "") -> None:
    """Add the options of a mesh in a Blender file. more: on slots, for their help."""
    add.add_argument("--object", metavar="NAME", help="mesh object in FILE")
    add.add_argument("--slots", metavar="A,B", help=f"use only these material slots, by name or by number from 0{more}")
    add.add_argument("--occluder", action="append", default=[], metavar="NAME",
                     help="object in FILE that hides and shadows the mesh; may be repeated")  # fmt: skip


def add_shelf(add: argparse.ArgumentParser) -> None:
    """Add the options of an asset: name, catalog, author, licence and tags."""
    add.add_argument("--asset-name", metavar="NAME",
                     help="name of the asset (default: the subject's; of export, the result's)")  # fmt: skip
    add.add_argument("--catalog", metavar="A/B", help="catalog of the asset; created if the library lacks it")
    add.add_argument("--author", metavar="NAME", help="author of the asset")
    add.add_argument("--license", metavar="L", help="licence of the asset, as CC-BY-4.0")
    add.add_argument("--tag", action="append", default=[], metavar="WORD", help="tag of the asset; may be repeated")


def part(text: str) -> float:
    """Return a number above 0 and at most 1."""
    try:
        number = float(text)
    except ValueError:
        number = float("nan")
    if not 0 < number <= 1:
        raise argparse.ArgumentTypeError(f"{text}: give a number above 0 and at most 1")
    return number


def seed(text: str) -> int:
    """Return a seed; shaders read it as a signed 32-bit integer."""
    try:
        number = int(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text} is not a whole number") from error
    if not -(2**31) <= number < 2**31:
        raise argparse.ArgumentTypeError(f"{text} does not fit 32 bits; give a whole number of up to nine digits")
    return number
