"""The button that opens the capture to practise on."""

from functools import partial

import bpy
import numpy as np
import pytest

from irpso_addon.blender.images import decode
from irpso_addon.capture.read import read_capture
from irpso_addon.core.errors import InputError
from irpso_addon.sample import layout
from irpso_addon.ui.operators import sample
from tests.builders.balls import degrees

pytestmark = [pytest.mark.bpy_only, pytest.mark.usefixtures("registered")]

SIZE, COUNT = (300, 225), 6  # the ball has a radius of 18 pixels


def small(monkeypatch):
    """Let the button render fewer and smaller photographs."""
    options = ["--size", f"{SIZE[0]}x{SIZE[1]}", "--photographs", str(COUNT)]
    monkeypatch.setattr(sample, "_rendering", partial(sample._rendering, options=options))


def test_the_sample_is_rendered_once_and_opens_with_its_lights_and_its_tile(monkeypatch, tmp_path):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    small(monkeypatch)
    folder = tmp_path / "sample"
    assert bpy.ops.irpso.open_sample(folder=str(folder)) == {"FINISHED"}
    settings, found = bpy.context.scene.irpso, layout.make_layout(SIZE, COUNT, 0)
    assert settings.framing == "CROP" and tuple(settings.crop) == layout.tile_crop(found.camera)
    assert settings.card_distance == pytest.approx(found.card_distance)
    assert not [item for item in settings.findings if "distance" in item.message]
    capture = read_capture(settings.capture_path, decode)
    assert capture.name == "tile"
    lamps = [one.light.vector for one in capture.observations]
    true = found.lamps - found.camera.position
    seen = np.array([*layout.TILE, 0.0]) - found.camera.position
    assert degrees(np.array(lamps) - seen, true - seen).max() < 10.0  # a ball of 18 pixels
    photographs = sorted((folder / "photographs").glob("*.jpg"))
    taken = [photograph.stat().st_mtime_ns for photograph in photographs]
    assert bpy.ops.irpso.open_sample(folder=str(folder)) == {"FINISHED"}
    assert [photograph.stat().st_mtime_ns for photograph in photographs] == taken
    table = folder / "photographs" / "capture.toml"
    assert settings.capture_path == str(table) and list(table.parent.glob("*.toml")) == [table]
    table.write_text(edited := f"{table.read_text()}# mine\n")
    assert bpy.ops.irpso.open_sample(folder=str(folder)) == {"FINISHED"}
    assert settings.capture_path.endswith("capture_1.toml") and table.read_text() == edited


def test_a_folder_with_other_files_is_refused_in_the_words_of_the_command(monkeypatch, tmp_path):
    small(monkeypatch)
    (tmp_path / "mine.txt").write_text("keep")
    with pytest.raises(RuntimeError, match="is there already and not empty"):
        bpy.ops.irpso.open_sample(folder=str(tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_cancelling_ends_the_process_and_leaves_nothing(monkeypatch, tmp_path):
    begun = "import os, pathlib, time; pathlib.Path(sys.argv[-1]).write_text(''); time.sleep(600)"
    monkeypatch.setattr(sample, "_CHILD", begun.replace("sys.argv[-1]", f"{str(tmp_path)!r} + f'/{{os.getpid()}}'"))
    steps = sample._rendering(tmp_path / "sample")
    assert next(steps) == 0
    while not (files := list(tmp_path.iterdir())):
        next(steps)
    partial_folder = tmp_path / f".sample.partial-{files[0].name}"
    partial_folder.mkdir()
    steps.close()
    assert not partial_folder.exists()


def test_a_process_that_dies_is_one_line(monkeypatch, tmp_path):
    monkeypatch.setattr(sample, "_CHILD", "sys.stderr.write('no memory left'); sys.exit(9)")
    with pytest.raises(InputError, match="no memory left"):
        list(sample._rendering(tmp_path / "sample"))
