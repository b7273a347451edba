"""Bakes of several UDIM tiles and of some material slots, against the oracle's of the same triangles; wide domains."""

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.capture.camera import Camera
from irpso_addon.core.errors import InputError
from irpso_addon.geometry.domain import GeometryBake, domain_of
from irpso_addon.geometry.surface import bake
from irpso_addon.geometry.surface.udim import lay_out
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.views import forward
from tests.oracles import geometry as oracle


def tiled(*places, sizes=None):
    """Return spheres with their texture coordinates in these tiles, a slot each, as one mesh in the layout."""
    parts = [oracle.sphere(columns=9, rows=7, centre=(3 * k, 0, 0)) for k in range(len(places))]
    uvs = np.concatenate([part.uvs * 0.9 + 0.05 + np.float32(at) for part, at in zip(parts, places, strict=True)])
    mesh = oracle.joined(*parts)
    tiles, uvs = lay_out("test", uvs)
    slots = np.repeat(np.arange(len(places), dtype=np.int32), len(parts[0].uvs))
    return replace(mesh, uvs=uvs, tiles=tiles, materials=slots, slots=tuple("ABC"[: len(places)]))


def test_tiles_are_baked_side_by_side():
    mesh = tiled((3, 1), (0, 0), (1, 0))
    assert mesh.tiles == (1001, 1002, 1014) and mesh.domain_size(20, 30) == (60, 30)
    drawn = bake.bake_uv(mesh, 60, 30)
    # The first sphere lies in the last tile.
    for columns, centre in ((slice(0, 20), 3), (slice(20, 40), 6), (slice(40, 60), 0)):
        covered = drawn.coverage[:, columns]
        distance = np.linalg.norm(drawn.position[:, columns][covered] - (centre, 0, 0), axis=-1)
        assert covered.mean() > 0.7 and distance.min() > 0.8 and distance.max() < 1 + 1e-5
    expected, distance = oracle.bake_uv(mesh, 60, 30)
    clear = distance > 1e-3
    np.testing.assert_array_equal(drawn.coverage[clear], expected.coverage[clear])
    np.testing.assert_allclose(drawn.position[clear], expected.position[clear], atol=1e-5)
    np.testing.assert_array_equal(bake.uv_coverage(mesh, 60, 30)[clear], expected.coverage[clear])


def test_a_domain_wider_than_a_texture_bakes_in_blocks_without_change(monkeypatch):
    mesh = tiled((0, 0), (1, 0), (2, 0))
    whole = bake.bake_uv(mesh, 69, 31)
    monkeypatch.setattr(bake, "_MAX_SIDE", 20)
    blocks = bake.bake_uv(mesh, 69, 31)
    clear = oracle.bake_uv(mesh, 69, 31)[1] > 1e-3
    assert clear.mean() > 0.95
    np.testing.assert_array_equal(blocks.triangle[clear], whole.triangle[clear])
    for name in ("position", "normal", "tangent", "uv", "face_normal"):
        np.testing.assert_allclose(getattr(blocks, name)[clear], getattr(whole, name)[clear], atol=2e-5)


def test_one_place_in_two_tiles_is_no_overlap_and_in_one_tile_the_slots_are_named():
    assert bake.overlap(tiled((0, 0), (1, 0), (0, 3)), 256) == 0
    both = tiled((0, 0), (1, 0), (1, 0))
    assert bake.overlap(both, 256) == pytest.approx(0.5, abs=0.01)
    with pytest.raises(InputError, match=r"over 50 % .* slots 'B', 'C' share it; recover them one by one \(--slots\)"):
        bake.bake_uv(both, 16, 16)
    within = replace(both, materials=both.materials * 0)
    with pytest.raises(InputError, match="unwrap the mesh without overlaps"):
        bake.bake_uv(within, 16, 16)


def test_triangles_of_other_slots_have_no_texels_and_are_still_seen():
    both = tiled((0, 0), (0, 0))
    mesh = replace(both, solved=both.materials == 1)
    drawn = bake.bake_uv(mesh, 24, 24)
    assert drawn.coverage.mean() > 0.7 and (both.materials[drawn.triangle[drawn.coverage]] == 1).all()
    assert mesh.solved_slots == (1,) and both.solved_slots == (0, 1)
    matrix = np.eye(4)
    matrix[:3, 3] = 1.5, 0, 5
    seen = bake.bake_camera(mesh, Camera(64, 32, (12.0, 12.0), (32.0, 16.0), matrix, False))
    assert set(both.materials[seen.triangle[seen.coverage]]) == {0, 1}


def test_a_domain_wider_than_a_texture_renders_in_blocks_without_change(monkeypatch):
    random = np.random.default_rng(3)
    shape = 7, 45
    normal = oracle.unit(random.normal(size=(*shape, 3)) * 0.2 + (0, 0, 1)).astype(np.float32)
    surface = GeometryBake(
        position=random.normal(size=(*shape, 3)).astype(np.float32),
        normal=normal,
        tangent=np.tile(np.float32([1, 0, 0, 1]), (*shape, 1)),
        coverage=random.random(shape) < 0.9,
        uv=np.zeros((*shape, 2), np.float32),
    )
    lights = np.float32([(0, 0.6, 0.8, 0), (0.5, 0.2, 3, 1)])
    ones = np.ones((2, 3), np.float32)
    domain = domain_of(surface, np.zeros((2, *shape, 4), np.float32), lights, ones, np.float32([(0, 0, 1, 0)] * 2))
    values = {"base_color": random.random((*shape, 3)).astype(np.float32), "normal": normal}
    whole = [*forward.rendered(domain, load_model("lambert"), values, [1, 0])]
    monkeypatch.setattr(forward.context, "max_texture_size", lambda: 20)
    blocks = [*forward.rendered(domain, load_model("lambert"), values, [1, 0])]
    np.testing.assert_array_equal(blocks, whole)
    # The distant light by hand: albedo times cosine.
    cosine = np.maximum(normal @ lights[0, :3], 0)[..., None]
    expected = np.where(surface.coverage[..., None], values["base_color"] * cosine, 0)
    np.testing.assert_allclose(blocks[1][..., :3], expected, atol=2e-6)
