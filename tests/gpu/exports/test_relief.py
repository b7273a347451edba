"""A relief as a body: closed, of the right volume and size, and read back by hand from STL, PLY and OBJ."""

import json
import struct

import bpy
import numpy as np
import pytest

from irpso_addon import cli
from irpso_addon.commands import export
from irpso_addon.core.errors import InputError
from irpso_addon.exports.relief import write_relief
from irpso_addon.exports.result import Result
from irpso_addon.geometry.relief.height import Height
from irpso_addon.geometry.relief.solid import relief_solid
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.maps import Maps
from tests.builders.command_line import run_cli

SHAPE = (9, 13)


def leaf(unit="texels"):
    """A relief with a hole and a bitten corner."""
    covered = np.ones(SHAPE, bool)
    covered[4, 6:8] = covered[:2, :3] = False
    y, x = np.mgrid[:9, :13]
    return Height(np.float32(np.where(covered, np.sin(0.7 * x) + 0.1 * y, 0)), covered, unit)


def result(height):
    return Result("leaf", Maps(load_model("lambert"), {}, np.ones(SHAPE, bool)), height)


def triangles_of(path):
    """Return (T, 3, 3) corners of a binary STL."""
    data = path.read_bytes()
    (count,) = struct.unpack_from("<I", data, 80)
    return np.frombuffer(data, np.dtype([("n", "<3f4"), ("v", "<(3,3)f4"), ("a", "<u2")]), count, 84)["v"].astype(float)


def volume_of(triangles):
    a, b, c = np.moveaxis(triangles, 1, 0)
    return (a * np.cross(b, c)).sum() / 6


def touching():
    """Reliefs whose holes, or whose parts, touch at one texel, along both diagonals."""
    holes, parts = np.ones(SHAPE, bool), np.zeros(SHAPE, bool)
    holes[2, 2] = holes[4, 4] = holes[4, 8] = holes[6, 6] = False
    parts[:3, :3] = parts[2:5, 2:8] = parts[4:, 7:] = parts[4:, 1:3] = True
    random = np.random.default_rng(3).normal(size=SHAPE).astype(np.float32)
    return [Height(np.where(covered, random, 0), covered, "texels") for covered in (holes, parts)]


@pytest.mark.parametrize("height", touching())
def test_every_edge_belongs_to_two_faces_even_where_equal_places_are_joined(height):
    vertices, quads = relief_solid(height, 130.0, 4.0)
    _, joined = np.unique(vertices.round(3), axis=0, return_inverse=True)
    faces = joined.reshape(-1)[quads]
    edges = np.sort(np.concatenate([faces[:, [k, (k + 1) % 4]] for k in range(4)]), axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    assert (count == 2).all()
    # Seen from above, all faces of the top turn the same way: no part is drawn into its neighbour.
    a, b, _, d = np.moveaxis(vertices[quads[(vertices[quads][..., 2] > 0).all(axis=1)]], 1, 0)
    assert (np.cross(b - a, d - a)[:, 2] > 0).all()


def test_the_body_is_closed_and_every_edge_has_its_reverse():
    vertices, quads = relief_solid(leaf(), 130.0, 4.0)
    edges = np.concatenate([quads[:, [k, (k + 1) % 4]] for k in range(4)])
    assert len(np.unique(edges, axis=0)) == len(edges)
    np.testing.assert_array_equal(np.unique(edges, axis=0), np.unique(edges[:, ::-1], axis=0))
    assert vertices[:, 2].min() == 0 and np.unique(vertices[:, 2])[1] == pytest.approx(4.0)


def test_stl_has_the_card_s_width_depth_and_volume(tmp_path):
    height = leaf()
    found = write_relief(result(height), tmp_path / "leaf.stl", 130.0)
    triangles = triangles_of(tmp_path / "leaf.stl")
    points = triangles.reshape(-1, 3)
    np.testing.assert_allclose(np.ptp(points, axis=0)[:2], (120, 80), atol=1e-3)  # through the texels' middles
    z = 10.0 * height.values
    inside = height.values[height.covered]
    assert found["depth"] == pytest.approx(10 * float(np.ptp(inside)), rel=1e-5)
    whole = height.covered[:-1, :-1] & height.covered[:-1, 1:] & height.covered[1:, 1:] & height.covered[1:, :-1]
    mean = (z[:-1, :-1] + z[:-1, 1:] + z[1:, 1:] + z[1:, :-1]) / 4 - z[height.covered].min() + 2.6
    # A quad's two triangles and its bilinear patch differ a little.
    assert volume_of(triangles) == pytest.approx(100 * mean[whole].sum(), rel=0.02)


def test_ply_and_obj_have_the_same_body_and_the_open_file_stays(tmp_path):
    before = [len(getattr(bpy.data, kind)) for kind in ("objects", "meshes")]
    vertices, quads = relief_solid(leaf(), 100.0, 2.0)
    write_relief(result(leaf()), tmp_path / "leaf.ply")
    header = (tmp_path / "leaf.ply").read_bytes().split(b"end_header")[0].decode()
    assert f"element face {len(quads)}" in header
    write_relief(result(leaf()), tmp_path / "leaf.obj")
    lines = (tmp_path / "leaf.obj").read_text().splitlines()
    points = np.array([line.split()[1:4] for line in lines if line.startswith("v ")], float)
    assert len(points) == len(vertices) and sum(line.startswith("f ") for line in lines) == len(quads)
    np.testing.assert_allclose(sorted(points[:, 1]), sorted(vertices[:, 2]), atol=1e-4)  # y is up
    assert sorted(path.name for path in tmp_path.iterdir()) == ["leaf.obj", "leaf.ply"]
    assert before == [len(getattr(bpy.data, kind)) for kind in ("objects", "meshes")]


@pytest.mark.parametrize("suffix", ["stl", "ply", "obj"])
def test_the_command_writes_nothing_but_its_json(suffix, tmp_path, monkeypatch, capfd):
    """Blender's exporters write from C how long they took."""
    monkeypatch.setattr(export, "read_result", lambda *_: result(leaf()))
    path = tmp_path / f"leaf.{suffix}"
    assert cli.main(["export", "leaf", "--format", "relief", "-o", str(path), "--json"]) == 0
    said, error = capfd.readouterr()
    assert json.loads(said)["output"] == str(path) and error == ""


def test_the_command_replaces_a_file_only_on_request(tmp_path, monkeypatch):
    monkeypatch.setattr(export, "read_result", lambda *_: result(leaf()))
    (mine := tmp_path / "leaf.stl").write_text("mine")
    words = ("export", "leaf", "--format", "relief", "-o", mine)
    code, _, said = run_cli(*words)
    assert code == 2 and f"{mine}: is there already" in said and mine.read_text() == "mine"
    assert run_cli(*words, "--replace")[0] == 0 and len(triangles_of(mine)) > 0


@pytest.mark.parametrize(
    ("height", "width", "why"),
    [
        (None, 100.0, "recover with --height"),
        (leaf("world"), 100.0, "fine detail of a mesh"),
        (leaf(), 0.0, "--width"),
        (leaf(), np.inf, "--width inf"),
    ],
)
def test_what_has_no_relief_is_refused(height, width, why, tmp_path):
    with pytest.raises(InputError, match=why):
        write_relief(result(height), tmp_path / "leaf.stl", width)
    assert not list(tmp_path.iterdir())
