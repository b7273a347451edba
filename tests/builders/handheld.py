"""Handheld photographs of a flat card with a flash beside the lens, warped and lit by numpy in float64."""

from dataclasses import replace

import numpy as np

from irpso_addon.calibration.handheld.flash import irradiance
from irpso_addon.capture.frame.board import PAPERS, board_of, board_picture
from irpso_addon.capture.types import Capture, Light, Observation
from tests.builders.flat_scene import looking_camera, seen_plane, texture

SIZE, FOCAL = (320, 240), 340.0
OFFSET, BEAM, STRENGTH = np.array([14.0, -8.0, 0.0]), 2.5, 9e4


def hand(count, seed=0, widest=48.0, far=360.0):
    """Return cameras around the plane's origin, about ``far`` away, up to ``widest`` degrees off its normal."""
    random = np.random.default_rng(seed)
    return [
        looking_camera(
            SIZE, FOCAL, random.uniform(0.85, 1.15) * far, widest * np.sqrt((k + 0.5) / count), 137.5 * k,
            random.uniform(-25, 25), tuple(random.uniform(-15, 15, 2)),
        )
        for k in range(count)
    ]  # fmt: skip


def photographs(cameras, value, blurred=(), gloss=0.0):
    """Return a capture of pictures under the flash beside each camera; value: points (…, 2) → reflectance.

    gloss: width of a Beckmann lobe of reflectance 0.04 in the field of a board; 0 for none.
    """
    shots = []
    for number, camera in enumerate(cameras):

        def lit(places, camera=camera):
            flat = places.reshape(-1, 2)
            shade = STRENGTH * irradiance(flat, camera.matrix, OFFSET, BEAM)
            return ((value(flat) + shining(flat, camera, gloss)) * shade).reshape(places.shape[:-1])

        grey = seen_plane(camera, lit)
        if number in blurred:
            grey = np.mean([np.roll(grey, step, axis=1) for step in range(-5, 6)], axis=0)
        picture = np.dstack([grey, grey, grey, np.ones_like(grey)]).astype(np.float32)
        light = Light((0, 0, 1))
        shots.append(Observation(f"IMG_{number}", lambda p=picture: p, light, number))
    blank = tuple(replace(camera, matrix=np.eye(4)) for camera in cameras)
    return Capture("card", tuple(shots), blank, tuple(np.ones(SIZE[::-1], bool) for _ in cameras))


def shining(places, camera, width):
    """Return the reflectance (N,) of a Beckmann lobe in the field of a board, under the camera's flash."""
    if not width:
        return 0.0
    points = np.insert(places, 2, 0.0, axis=1)
    eye, lamp = camera.position, camera.matrix[:3, :3] @ OFFSET + camera.position
    view, light = ((at - points) / np.linalg.norm(at - points, axis=1, keepdims=True) for at in (eye, lamp))
    half = (view + light) / np.linalg.norm(view + light, axis=1, keepdims=True)
    cosine = half[:, 2]
    lobe = np.exp((1 - 1 / cosine**2) / width**2) / (width**2 * cosine**4) * 0.04 / (4 * view[:, 2] * light[:, 2])
    return np.where((np.abs(places) < np.array(board_of("A4", 8).field) / 2 - 4).all(axis=-1), lobe, 0)


def on_board(places):
    """Return the reflectance of a printed marker board with a textured card in its field, on a black table."""
    board = board_of("A4", 8)
    if not hasattr(on_board, "ink"):
        on_board.ink = np.asarray(board_picture(board, 80).convert("L"), float) / 255
    size, ink = np.array(PAPERS["A4"]), on_board.ink
    at = np.floor((places * (1, -1) + size / 2) / size * ink.shape[::-1]).astype(int)
    paper = ((at >= 0) & (at < ink.shape[::-1])).all(axis=-1)
    at = np.clip(at, 0, np.array(ink.shape[::-1]) - 1)
    card = (np.abs(places) < np.array(board.field) / 2 - 4).all(axis=-1)
    board_value = np.where(paper, 0.03 + 0.77 * ink[at[..., 1], at[..., 0]], 0.01)
    return np.where(card, 0.2 + 0.5 * texture(3, 10.0)(places), board_value)
