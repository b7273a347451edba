"""Develop and rigs in the window: chart found or marked, the result imported; a rig saved and applied."""

import json
from pathlib import Path

import bpy
import numpy as np
import pytest

from irpso_addon.capture.images.exr import write_exr
from irpso_addon.capture.read import read_capture
from tests.builders.captures import LIGHTS, write_png
from tests.builders.chart_scenes import scene

pytestmark = [pytest.mark.bpy_only, pytest.mark.usefixtures("registered")]
SHOWN = scene(333)


@pytest.fixture
def settings(registered, tmp_path):
    """A capture of five lamps whose second photograph shows a chart, imported."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    folder = tmp_path / "photographs"
    folder.mkdir()
    for n in range(5):
        linear = SHOWN.rgba[::-1, :, :3] if n == 1 else np.full_like(SHOWN.rgba[..., :3], 0.1 + 0.05 * n)
        write_png(folder / f"{n}.png", np.rint(linear * 65535).astype(int), 16)
    (folder / "filenames.txt").write_text("".join(f"{n}.png\n" for n in range(5)))
    np.savetxt(folder / "light_directions.txt", LIGHTS)
    bpy.ops.irpso.import_capture(directory=str(folder))
    return bpy.context.scene.irpso


def colours(settings):
    return json.loads((Path(settings.capture_path) / "report.json").read_text())["colour_chart"]


def test_develop_finds_the_chart_and_imports_linear_images(settings, tmp_path):
    assert bpy.ops.irpso.develop() == {"FINISHED"}
    assert settings.capture_path == str(tmp_path / "photographs_linear") and settings.source == "FILES"
    found = colours(settings)
    assert found["found"] and found["file"].endswith("1.png") and found["delta_e_2000"]["after"]["mean"] < 2
    capture = read_capture(settings.capture_path)
    np.testing.assert_allclose([o.light.vector for o in capture.observations], LIGHTS, atol=1e-6)


def test_the_subject_and_its_frame_stay_as_they_were(settings):
    settings.framing, settings.crop, settings.picture_scale, settings.card_width = "CROP", (4, 2, 30, 20), 0.5, 120
    settings.subject = "MESH"
    bpy.ops.irpso.import_capture(directory=settings.capture_path)
    assert settings.subject == "MESH"
    assert bpy.ops.irpso.develop() == {"FINISHED"}
    assert settings.subject == "MESH"
    assert (settings.framing, tuple(settings.crop), settings.picture_scale) == ("CROP", (4, 2, 30, 20), 0.5)
    assert settings.card_width == 120


def test_a_marked_chart_in_its_own_photograph(settings, tmp_path):
    settings.chart_photograph = str(tmp_path / "photographs" / "1.png")
    with pytest.raises(RuntimeError, match="no chart is marked"):
        bpy.ops.irpso.develop(colours="MARKED")
    bpy.ops.irpso.mark_chart(corners=SHOWN.corners[[2, 0, 3, 1]].ravel())
    assert settings.framing == "FILE"  # the card's own corners stay
    assert bpy.ops.irpso.develop(colours="MARKED") == {"FINISHED"}
    found = np.reshape(colours(settings)["corners"], (4, 2))
    np.testing.assert_allclose(found, SHOWN.corners, atol=0.01)
    assert not any(settings.chart_corners) and settings.chart_photograph == ""  # of the former capture


def test_a_gray_card_is_found_for_the_white_balance(settings, tmp_path):
    shown = scene(340, chart=False, card=True, dimmest=0.85)
    settings.chart_photograph = str(tmp_path / "card.png")
    write_png(tmp_path / "card.png", np.rint(shown.rgba[::-1, :, :3] * 65535).astype(int), 16)
    assert bpy.ops.irpso.develop(colours="GREY") == {"FINISHED"}
    report = json.loads((Path(settings.capture_path) / "report.json").read_text())
    x, y = shown.corners.mean(axis=0).astype(int)
    seen = shown.rgba[-1 - y, x, :3] * report["white_gains"]
    assert report["grey_card"]["file"].endswith("card.png") and np.ptp(seen) < 0.05 * seen.mean()


def test_dark_frames_are_subtracted(settings, tmp_path):
    write_exr(tmp_path / "dark.exr", {"": dict.fromkeys("RGB", np.full(SHOWN.rgba.shape[:2], 0.05, np.float32))})
    assert bpy.ops.irpso.develop(colours="NONE", dark=str(tmp_path / "dark.exr")) == {"FINISHED"}
    values = read_capture(settings.capture_path).observations[2].read()[..., :3]
    np.testing.assert_allclose(values, 0.15, atol=1e-4)


def test_what_fails_is_one_line_and_leaves_the_capture(settings, tmp_path):
    before = settings.capture_path, sorted(p.name for p in tmp_path.iterdir())
    marked = "or use Mark Chart in Photograph"
    for words, last, given in (
        ("holds no images", "", {"dark": "/nowhere"}),
        ("no 24-patch chart", marked, {}),
        ("no grey card", "let nothing cover the card", {"colours": "GREY"}),
    ):
        if last:
            settings.chart_photograph = str(tmp_path / "photographs" / "0.png")
        with pytest.raises(RuntimeError, match=words) as caught:
            bpy.ops.irpso.develop(**given)
        assert str(caught.value).strip().endswith(last) and "--" not in str(caught.value)
    assert (settings.capture_path, sorted(p.name for p in tmp_path.iterdir())) == before


def test_a_rig_is_saved_and_applied(settings, tmp_path):
    bpy.ops.irpso.develop()
    assert bpy.ops.irpso.save_rig(filepath=str(tmp_path / "dome")) == {"FINISHED"}
    later = tmp_path / "later"
    later.mkdir()
    for n in range(5):
        write_png(later / f"{n}.png", np.full((*SHOWN.rgba.shape[:2], 3), 9000 * (n != 3)), 16)
    assert bpy.ops.irpso.apply_rig(rig=str(tmp_path / "dome"), photographs=str(later)) == {"FINISHED"}
    assert settings.capture_path == str(tmp_path / "later_capture")
    capture = read_capture(settings.capture_path)
    np.testing.assert_allclose([o.light.vector for o in capture.observations], np.delete(LIGHTS, 3, axis=0), atol=1e-6)
    with pytest.raises(RuntimeError, match="Photographs: no folder is chosen"):
        bpy.ops.irpso.apply_rig(rig=str(tmp_path / "dome"))
    with pytest.raises(RuntimeError, match="is no rig"):
        bpy.ops.irpso.apply_rig(rig=str(later), photographs=str(later))


@pytest.fixture
def later(settings, tmp_path):
    """A rig of the photographs, ``dome``, and the folder of other photographs under its lamps."""
    bpy.ops.irpso.save_rig(filepath=str(tmp_path / "dome"))
    later = tmp_path / "later"
    later.mkdir()
    for n in range(5):
        write_png(later / f"{n}.png", np.full((*SHOWN.rgba.shape[:2], 3), 9000), 16)
    return later


def test_a_photograph_chosen_for_a_rig_stands_for_its_folder(settings, later, tmp_path):
    chosen = {"rig": str(tmp_path / "dome"), "filepath": str(later / "0.png")}
    assert bpy.ops.irpso.choose_photographs(**chosen) == {"FINISHED"}
    assert settings.capture_path == str(tmp_path / "later_capture")


def test_a_video_is_refused_for_a_rig(settings, later, tmp_path):
    (tmp_path / "lamp.mp4").touch()
    before = settings.capture_path
    with pytest.raises(RuntimeError, match=r"lamp\.mp4: is a video; a rig needs a photograph for each lamp"):
        bpy.ops.irpso.choose_photographs(rig=str(tmp_path / "dome"), filepath=str(tmp_path / "lamp.mp4"))
    assert settings.capture_path == before
