"""Photographs of a known scene by a camera with vignetting, offset and tint, at several exposures, for ``develop``."""

import numpy as np

from tests.builders.captures import LIGHTS, chunk, shade, sphere, write_png
from tests.builders.exif import exif

SIZE = 48
TIMES = ((1, 240), (1, 60), (1, 15))
NORMALS, BALL = sphere(SIZE)
TINT = np.array([0.9, 0.6, 0.4])
OFFSET = 0.01
Y, X = np.meshgrid(np.linspace(-1, 1, SIZE), np.linspace(-1, 1, SIZE), indexing="ij")
VIGNETTE = 1 - 0.3 * (X**2 + Y**2)
CARD = np.s_[2:8, 3:9]  # rows from the bottom, columns: a grey card of 0.18
SCENE = shade(NORMALS)
SCENE[(slice(None), *CARD)] = 0.18
BRIGHT = 4.0  # at the shortest exposure 1/240 s the file's largest value stands for this radiance
EVERYTHING = ("--brackets", "exif", "--white", f"3,{SIZE - 8},6,6=0.18")


def write(path, light, seconds, bits=16, curve=lambda v: v):
    """Write what a camera makes of light (H, W, 3), row 0 at the bottom, at an exposure."""
    codes = np.rint(np.clip(curve(np.clip(light, 0, 1)), 0, 1) * (2**bits - 1)).astype(int)
    write_png(path, codes[::-1], bits, chunk(b"eXIf", exif(seconds)))


def write_photographs(folder):
    """Write 5 lights × 3 exposures, a dark frame for each, and a flat field, into a new folder; return it."""
    for name in ("", "dark", "flat"):
        (folder / name).mkdir(parents=True)
    for k, frame in enumerate(SCENE):
        for i, (_, below) in enumerate(TIMES):
            light = frame[..., None] * TINT * VIGNETTE[..., None] * (240 / below) / BRIGHT + OFFSET
            write(folder / f"{3 * k + i:02d}.png", light, TIMES[i])
    for i, time in enumerate(TIMES):
        write(folder / "dark" / f"{i}.png", np.full((SIZE, SIZE, 3), OFFSET), time)
    write(folder / "flat" / "a.png", 0.7 * TINT * VIGNETTE[..., None] + OFFSET, TIMES[1])
    names = [f"{3 * k + 1:02d}.png" for k in range(len(LIGHTS))]
    (folder / "filenames.txt").write_text("".join(f"{name}\n" for name in names))
    np.savetxt(folder / "light_directions.txt", LIGHTS)
    return folder


def everything(folder):
    """Return the options for all corrections of ``write_photographs``."""
    return (*EVERYTHING, "--dark", folder / "dark", "--flat", folder / "flat")
