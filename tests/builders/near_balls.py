"""Photographs of two matte balls on a card, under near lamps, in millimetres."""

import numpy as np

from irpso_addon.capture.camera import Camera
from irpso_addon.capture.images.exr import write_exr
from tests.builders.balls import matte_image

BALLS = [((-30.0, 0.0, -410.0), 10.0), ((30.0, 5.0, -410.0), 10.0)]  # they lie on a card at 420
LAMPS = [(100.0, 80.0, -260.0), (-90.0, 60.0, -250.0), (20.0, -110.0, -270.0), (0.0, 40.0, -200.0)]
FOV = 20.0


def write_near_balls(folder):
    """Write 0.exr … 3.exr into a new folder; return the place of each ball as an option's value, "X,Y,R"."""
    camera = Camera.from_fov(240, 160, FOV)
    folder.mkdir()
    for k, lamp in enumerate(LAMPS):
        image = matte_image(camera, BALLS, lamp, False, albedo=(2e4,) * 3)
        write_exr(folder / f"{k}.exr", {"": {c: image[..., i] for i, c in enumerate("RGB")}})
    places = []
    for centre, radius in BALLS:
        (x, y), _ = camera.project(np.array(centre))
        places.append(f"{x},{160 - y},{radius * camera.scale[0] / 410}")
    return places
