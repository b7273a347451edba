"""``handheld``, ``markers`` and ``--corners auto`` on the command line: what they write, what they refuse."""

import json
import shlex

import numpy as np
import pytest

from irpso_addon.blender.mesh import extract_mesh
from irpso_addon.blender.scenes.scene import mesh_object, open_blend
from irpso_addon.capture.images.exr import write_exr
from irpso_addon.capture.read import read_capture
from tests.builders.command_line import run_cli
from tests.builders.handheld import BEAM, FOCAL, OFFSET, SIZE, hand, on_board, photographs

pytestmark = pytest.mark.bpy_only
FOV = np.degrees(2 * np.arctan(SIZE[0] / 2 / FOCAL))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder of photographs of a board, without lens in their files, and the cameras."""
    pytest.importorskip("cv2", reason="OpenCV is not installed")
    cameras, made = hand(9, seed=6, widest=40.0, far=500.0), tmp_path_factory.mktemp("hand") / "photos"
    made.mkdir()
    for shot in photographs(cameras, on_board).observations:
        image = shot.read()
        write_exr(made / f"{shot.name}.exr", {"": {name: image[..., k] for k, name in enumerate("RGB")}})
    return made, cameras


def test_photographs_taken_by_hand_become_a_capture_on_a_mesh(folder, tmp_path):
    photos, cameras = folder
    out = tmp_path / "capture of mine"
    code, told, error = run_cli("handheld", photos, "-o", out, "--fov", FOV)
    assert code == 0, error
    words = shlex.split(told.splitlines()[-1].partition("recover it with: ")[2])
    assert words[:5] == ["irpso", "recover", str(out), "--blend", str(out / "card.blend")]
    out = tmp_path / "capture"
    code, told, error = run_cli("handheld", photos, "-o", out, "--fov", FOV, "--json")
    assert code == 0, error
    told = json.loads(told.splitlines()[-1])
    assert told["photographs"] == 9 and told["markers"] == "8 markers on A4"
    np.testing.assert_allclose(told["flash_offset"], OFFSET, atol=3.0)
    capture = read_capture(out)
    for observation, camera in zip(capture.observations, cameras, strict=True):
        found = capture.cameras[observation.camera]
        assert np.linalg.norm(found.position - camera.position) < 0.015 * np.linalg.norm(camera.position)
        lamp = camera.matrix[:3, :3] @ OFFSET + camera.position
        assert np.linalg.norm(np.array(observation.light.vector) - lamp) < 10.0
        assert observation.light.cosine == pytest.approx(BEAM, abs=0.3)
    open_blend(out / "card.blend")
    mesh = extract_mesh(mesh_object("Card"))
    np.testing.assert_allclose(np.abs(mesh.positions).reshape(-1, 3).max(axis=0), (65, 108.5, 0), atol=1e-3)
    assert (mesh.normals[..., 2] == 1).all()
    corner = mesh.positions[(mesh.uvs == 0).all(axis=-1)][0]
    np.testing.assert_allclose(corner, (-65, -108.5, 0), atol=1e-3)
    code, _, error = run_cli("handheld", photos, "-o", out)
    assert code == 2 and "is there already" in error


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--flash-offset", "1,2"], "--flash-offset 1,2: give X,Y,Z in millimetres"),
        (["--fov", "190"], "--fov 190: give the full angle"),
        (["--fov", "20"], "correct --fov, or leave it out"),
    ],
)
def test_wrong_options_are_refused_and_nothing_is_written(folder, tmp_path, words, message):
    code, _, error = run_cli("handheld", folder[0], "-o", tmp_path / "out", *words)
    assert code == 2 and message in error
    assert not (tmp_path / "out").exists()


def test_a_board_is_written_for_both_papers(tmp_path):
    pytest.importorskip("cv2", reason="OpenCV is not installed")
    code, told, error = run_cli("markers", "-o", tmp_path / "board.pdf", "--paper", "letter", "--count", "4", "--json")
    assert code == 0, error
    assert json.loads(told.splitlines()[-1])["field"] == [135.9, 199.4]
    assert (tmp_path / "board.pdf").read_bytes().startswith(b"%PDF")
