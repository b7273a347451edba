"""Detection of balls in photographs of tables, and the lights from the detected balls, against the truth.

Usage: python -m benchmarks.balls [--quick] [--again] [--output FOLDER]

Cycles renders tables (benchmarks/scenes/ball_tables.py) with mirror balls, matte balls or none among bowls, coins,
cans, rings and other things; the photographs are blurred, noisy and of 8 bits. The program's thresholds were set on
scenes of seeds below 200; seeds from 201 are measured.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks import report
from benchmarks.scenes.ball_tables import BALL_SAMPLES, HEIGHT, SAMPLES, WIDTH, BallTable, photographed
from irpso_addon.calibration.balls.ball import SMALL, Ball
from irpso_addon.calibration.balls.detect.found import FoundBall, as_ball, known_tables
from irpso_addon.calibration.balls.detect.search import search_steps
from irpso_addon.calibration.balls.lights import KINDS, Request, calibration_steps
from irpso_addon.core.encode import srgb_from_linear
from irpso_addon.core.filters import blurred
from irpso_addon.core.steps import run_steps

_SEEDS = range(201, 237)
_LARGE_SEED = 1  # six photographs and one ball
_BLUR, _NOISE = 0.6, 0.004  # pixels, of white
_WHITE, _EXPOSURE = 98, 1.2  # percentile of all values, and the sensor's clipping level over it
_SAME = 0.3  # largest distance, over the radius, between the centres of a ball and its detection
_ENLARGED = 4
_HIDDEN = 0.5  # least visible part of the disc of a ball in the table


def measure(quick: bool) -> dict[str, Any]:
    """Search all scenes, or one if quick."""
    balls, empty, false = [], 0, []
    seeds = list(_SEEDS)[: 1 if quick else None]
    for seed in seeds:
        row = _scene(seed)
        report.say(f"{row['text']}: {row['balls']}; false: {row['false']}; {row['seconds']:.0f} s")
        balls += row["balls"]
        false += row["false"]
        empty += row["empty"]
    return {"balls": balls, "scenes": len(seeds), "empty": empty, "false": false, "large": _large(quick)}


def _scene(seed: int) -> dict[str, Any]:
    """Return the detections in a scene: rows of its balls, false ones, and the seconds of the search."""
    table = photographed(seed, report.CACHE)
    images = camera_images(table, seed)
    began = time.perf_counter()
    detected = _detected(images, table)
    seconds = time.perf_counter() - began
    rows, others = _matched(table, images, detected)
    scene = {"seed": seed, "near": bool(table.near), "cloth": bool(table.cloth)}
    false = [{"kind": o.kind, "radius": o.radius, "exact": bool(o.exact), "empty": not table.balls} for o in others]
    return {
        "text": f"seed {seed}: {table.text}", "balls": [{**scene, **row} for row in rows],
        "false": [{**scene, **row} for row in false], "empty": not table.balls, "seconds": seconds,
    }  # fmt: skip


def camera_images(table: BallTable, seed: int) -> list[np.ndarray]:
    """Return images (H, W, 4) like a reader's of 8-bit sRGB files: blurred, noisy, weight 0 where clipped."""
    rng = np.random.default_rng(seed)
    white = _EXPOSURE * np.percentile(table.images.mean(axis=-1), _WHITE)
    images = []
    for radiance in table.images:
        soft = np.stack([blurred(channel, _BLUR) for channel in np.moveaxis(radiance, -1, 0)], axis=-1) / white
        noisy = soft + _NOISE * rng.normal(size=soft.shape)
        codes = np.round(srgb_from_linear(np.clip(noisy, 0, 1)) * 255) / 255
        linear = np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)
        images.append(np.dstack([linear, (noisy < 1).all(axis=-1)]).astype(np.float32))
    return images


def _detected(images: Sequence[np.ndarray], table: BallTable) -> list[FoundBall]:
    return run_steps(search_steps([lambda image=image: image for image in images], table.camera, KINDS))


def _matched(
    table: BallTable, images: Sequence[np.ndarray], detected: Sequence[FoundBall]
) -> tuple[list[dict[str, Any]], list[FoundBall]]:
    """Return a row for each ball, and the detections without a ball."""
    rows, left = [], list(detected)
    for (kind, centre, radius), visible in zip(table.balls, table.visible, strict=True):
        middle, size = outline(Ball("truth", table.camera, centre, radius, 1.0, (0.0, 0.0)))
        row: dict[str, Any] = {"kind": kind, "radius": size, "visible": visible, "found": False}
        match = next((b for b in left if np.hypot(*(b.centre - middle)) < _SAME * size and b.kind == kind), None)
        if match is not None:
            left = [ball for ball in left if ball is not match]
            ball = as_ball(match, table.camera, "ball", None)
            place, across = outline(ball)
            readers = [lambda image=image: image for image in images]
            lights = run_steps(
                calibration_steps(
                    readers, [ball], Request(kind, inverse=match.inverse[0] / ball.radius, tables=known_tables([match]))
                )
            ).lights
            error = [
                float(np.degrees(np.arccos(np.clip(np.dot(light.light.vector, truth), -1, 1))))
                for light, truth in zip(lights, table.lights(centre), strict=True)
                if light.light is not None
            ]
            row |= {
                "found": True, "centre": float(np.hypot(*(place - middle)) / size), "across": across / size - 1,
                "light": float(np.mean(error)), "largest": max(error), "lights": len(error), "photographs": len(lights),
            }  # fmt: skip
        rows.append(row)
    return rows, left


def outline(ball: Ball) -> tuple[np.ndarray, float]:
    """Return the centre (2,) and the mean radius of a ball's outline, in pixels."""
    points = ball.outline[:-1]
    middle = (points.max(axis=0) + points.min(axis=0)) / 2
    return middle, float(np.linalg.norm(points - middle, axis=1).mean())


def _large(quick: bool) -> dict[str, Any]:
    """Return the seconds of the search in the enlarged photographs of a scene."""
    table = photographed(_LARGE_SEED, report.CACHE)
    images = camera_images(table, 0)
    times = 2 if quick else _ENLARGED
    width, height = times * table.camera.width, times * table.camera.height
    camera = type(table.camera)(
        width, height, tuple(times * v for v in table.camera.scale), (width / 2, height / 2), table.camera.matrix
    )
    readers = [lambda image=image: image.repeat(times, axis=0).repeat(times, axis=1) for image in images]
    began = time.perf_counter()
    detected = run_steps(search_steps(readers, camera, KINDS))
    seconds = time.perf_counter() - began
    return {"pixels": width * height, "photographs": len(images), "seconds": seconds, "found": len(detected)}


def write(data: dict[str, Any], folder) -> list[str]:
    """Return the page's lines."""
    empty, large = data["empty"], data["large"]
    none = sum(row["empty"] for row in data["false"])
    used = [row for row in data["false"] if row["exact"]]
    seen, hidden = _seen(data), [ball for ball in data["balls"] if ball["visible"] < _HIDDEN]
    sets = _sets(seen)
    rows = []
    for kind in KINDS:
        some = [ball for ball in seen if ball["kind"] == kind]
        sized = [ball for ball in some if ball["radius"] >= SMALL]
        rows += [
            [kind, "table, distant lamps", *_cells([b for b in sized if not b["cloth"] and not b["near"]])],
            [kind, "table, near lamps", *_cells([b for b in sized if not b["cloth"] and b["near"]])],
            [kind, "black cloth", *_cells([b for b in sized if b["cloth"]])],
            [kind, f"below {SMALL:g} pixels", *_cells([b for b in some if b["radius"] < SMALL])],
        ]
    return [
        f"{data['scenes']} scenes of {WIDTH} × {HEIGHT} pixels, {SAMPLES} samples and on balls up to {BALL_SAMPLES},"
        " six to eight lamps each; seeds that no threshold was set on. One or two balls of 3 to 30 % of"
        " the width, or none; bowls, coins, cans, rings,"
        " cones, eggs and boxes beside them; tables of albedo 0.05 to 0.8, plain, mottled or glossy, and in a fifth of"
        " the scenes black cloth of 0.003 to 0.02, up to 55° from the viewer; in half of the scenes suns, in half near"
        f" lamps 1.2 to 4 picture widths away. Blur of {_BLUR} pixels, noise of {_NOISE:.1%} of white, 8 bits, clipped"
        " highlights.",
        "",
        f"All balls of {SMALL:g} pixels and more found: in {sum(sets)} of {len(sets)} scenes that have such balls."
        f" False balls: {none} in {empty} scenes without a ball, {len(data['false']) - none} in the others; {len(used)}"
        f" of them of {SMALL:g} pixels and more, which calibration would use.",
        "",
        *report.table(
            ["ball", "where", "found", "centre within 1 %", "centre, median % of the radius", "radius, median %",
             "light within 1°", "light °: median of means, largest", "photographs with a light"], rows),
        f"Balls that other things hide by more than {1 - _HIDDEN:.0%} are not in the table: there are {len(hidden)},"
        f" {sum(ball['found'] for ball in hidden)} found. Lights are directions from the ball's centre. 3 % of this"
        f" width is a radius of {0.015 * WIDTH:.1f} pixels; in a photograph of 12 megapixels it is 60. The command"
        f" refuses balls that it measures smaller than {SMALL:g} pixels, unless their place is given. Photographs of a"
        " camera are not measured here.",
        "",
        f"{large['photographs']} photographs of {large['pixels'] / 1e6:.0f} megapixels (a scene, enlarged):"
        f" {large['seconds']:.0f} s, without the time to decode files.",
    ]  # fmt: skip


def _seen(data: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the balls that other things do not hide."""
    return [ball for ball in data["balls"] if ball["visible"] >= _HIDDEN]


def _sets(balls: Sequence[dict[str, Any]]) -> list[bool]:
    """Return, for each scene with balls large enough for calibration, whether all of these were detected."""
    sized = [ball for ball in balls if ball["radius"] >= SMALL]
    return [all(ball["found"] for ball in sized if ball["seed"] == seed) for seed in sorted({b["seed"] for b in sized})]


def _cells(balls: Sequence[dict[str, Any]]) -> list[str]:
    detected = [ball for ball in balls if ball["found"]]
    cells = [f"{len(detected)} of {len(balls)}"]
    if not detected:
        return [*cells, *["–"] * 6]
    centre, across, light, largest = (np.array([ball[key] for ball in detected]) for key in
                                      ("centre", "across", "light", "largest"))  # fmt: skip
    lights, photographs = (sum(ball[key] for ball in detected) for key in ("lights", "photographs"))
    return [
        *cells, f"{(centre < 0.01).sum()}", f"{100 * np.median(centre):.2f}", f"{100 * np.median(across):+.2f}",
        f"{(light < 1).sum()}", f"{np.median(light):.2f}, {largest.max():.1f}", f"{lights} of {photographs}",
    ]  # fmt: skip


def headline(data: dict[str, Any]) -> str:
    """Return the text of the index."""
    large = [ball for ball in _seen(data) if ball["radius"] >= SMALL]
    detected = [ball for ball in large if ball["found"]]
    none = sum(row["empty"] for row in data["false"])
    light = np.median([ball["light"] for ball in detected]) if detected else np.nan
    return (
        f"{len(detected)} of {len(large)} balls of radius {SMALL:g} pixels and more found, light {light:.2f}°; {none}"
        f" false in {data['empty']} scenes without a ball"
    )


PROGRAM = report.Program(
    "balls", "Balls found by themselves", __file__, measure, write, headline,
    (*report.CAPTURE, "irpso_addon/calibration", "benchmarks/scenes"),
)  # fmt: skip

if __name__ == "__main__":
    from irpso_addon.gpu import context

    report.run(PROGRAM)
    context.exit_process(0)
