"""Frames chosen from a video of a lamp that is carried around: different lights, no blur, no moving camera."""

from argparse import Namespace

import numpy as np
import pytest

from irpso_addon.blender.frames import Frames
from irpso_addon.calibration.video import check_camera, chosen_frames, describe_frame
from irpso_addon.commands.options import videos
from irpso_addon.core.errors import InputError
from tests.builders.video import direction, lit, scene

RNG = np.random.default_rng(5)
NORMALS, ALBEDO = scene()


def blurred(frame):
    """A frame out of focus: the mean of 5 × 5 pixels."""
    rows = sum(np.roll(frame, k, 0) for k in range(-2, 3)) / 5
    return sum(np.roll(rows, k, 1) for k in range(-2, 3)) / 5


def filmed(lights, change=lambda frame, k: frame):
    """Return linear frames with the noise of 8 bits."""
    frames = (change(lit(NORMALS, ALBEDO, light), k) for k, light in enumerate(lights))
    return [np.clip(frame + RNG.normal(0, 0.003, frame.shape), 0, 1) for frame in frames]


def looks_of(frames):
    return [describe_frame(frame, lambda linear: linear) for frame in frames]


def angles(lights, others):
    return np.degrees(np.arccos(np.clip(np.asarray(lights) @ np.asarray(others).T, -1, 1)))


def around(count, turns=1.0):
    return [direction(2 * np.pi * turns * k / count, np.radians(35 + 25 * np.sin(7 * k / count))) for k in range(count)]


def test_the_chosen_lights_lie_apart_though_the_lamp_rested_for_half_of_the_video():
    lights = [*around(120)[:1] * 120, *around(120)]
    chosen = [lights[k] for k in chosen_frames(looks_of(filmed(lights)), 12, "v")]
    apart = angles(chosen, chosen) + 180 * np.eye(len(chosen))
    assert len(chosen) == 12 and apart.min() > 8  # twelve frames at equal times: six of one light
    assert angles(lights, chosen).min(axis=1).max() < 35  # and every light is near a chosen one


def test_blurred_frames_are_passed_over():
    # Every second frame is out of focus; the light differs by 2° from one to the next.
    lights = around(180)
    frames = filmed(lights, lambda frame, k: blurred(frame) if k % 2 else frame)
    chosen = chosen_frames(looks_of(frames), 15, "v")
    assert len(chosen) == 15 and sum(k % 2 for k in chosen) <= 1


def test_frames_in_which_the_lamp_rests_are_preferred():
    # The lamp halts for five frames, then goes on for three; blur by its motion is not simulated.
    lights, resting = [], []
    for stop in around(24):
        for step in range(8):
            lights.append(stop if step < 5 else direction(np.arctan2(stop[1], stop[0]) + 0.05 * (step - 4), 0.6))
            resting.append(1 <= step <= 3)
    chosen = chosen_frames(looks_of(filmed(lights)), 12, "v")
    assert np.mean([resting[k] for k in chosen]) >= 0.75  # of all frames 0.375


def test_no_frame_is_chosen_twice_though_its_neighbours_are_less_sharp():
    lights = around(24)
    frames = filmed(lights, lambda frame, k: blurred(frame) if k % 3 else frame)
    chosen = chosen_frames(looks_of(frames), 16, "v")
    assert len(chosen) == len(set(chosen)) == 16


def test_faded_frames_are_left_out():
    lights = around(80)
    frames = filmed(lights, lambda frame, k: frame * min(1, k / 15, (79 - k) / 15))
    chosen = chosen_frames(looks_of(frames), 20, "v")
    assert min(chosen) >= 2 and max(chosen) <= 77


@pytest.mark.parametrize("written", [False, True])
def test_an_interrupt_removes_frames_unless_a_capture_refers_to_them(tmp_path, monkeypatch, written):
    def steps(found, folder, count):
        folder.mkdir()
        (folder / "a.png").touch()
        yield from ()
        return Frames(("a.png",), (1,), 1, ())

    monkeypatch.setattr(videos, "frame_steps", steps)
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.mp4").touch()
    options = Namespace(
        capture=tmp_path / "in", output=tmp_path / "out", replace=False, count=None, quiet=True, json=False
    )
    with pytest.raises(KeyboardInterrupt), videos.frames_of_videos(options) as frames:
        if written:
            (tmp_path / "out").mkdir()
            (tmp_path / "out" / "capture.toml").touch()
        raise KeyboardInterrupt
    assert frames[0].exists() == written


def test_a_video_of_one_light_is_refused_even_if_its_exposure_changes():
    frames = filmed([direction(0.4, 0.8)] * 30, lambda frame, k: frame * (0.5 + k / 60))
    with pytest.raises(InputError, match="lamp.mp4: shows 1 light, too few for a recovery"):
        chosen_frames(looks_of(frames), 10, "lamp.mp4")


def test_a_short_path_of_the_lamp_gives_fewer_frames():
    lights = [direction(0.004 * k, 0.7) for k in range(100)]  # 17° in all
    assert 3 <= len(chosen_frames(looks_of(filmed(lights)), 60, "v")) < 60


def greys(lights, shifts=None):
    frames = [frame.mean(axis=-1) for frame in filmed(lights)]
    return frames if shifts is None else [np.roll(f, s, (0, 1)) for f, s in zip(frames, shifts, strict=True)]


def test_a_still_camera_passes():
    assert check_camera(greys(around(14)), "v") == 0


@pytest.mark.parametrize("reach", [4, 20])
def test_a_camera_in_the_hand_is_refused(reach):
    shifts = [(round(reach * np.sin(k)), round(reach * np.cos(2 * k))) for k in range(14)]
    with pytest.raises(InputError, match=r"lamp.mp4: the camera moves: \d+ of 14 frames are shifted, by up to"):
        check_camera(greys(around(14), shifts), "lamp.mp4")


def test_one_frame_of_many_that_moved_is_counted():
    shifts = [(0, 0)] * 13 + [(5, 3)]
    assert check_camera(greys(around(14), shifts), "v") == 1
