"""Elements of interreflection on maps whose islands are smaller than the cells from which elements are chosen."""

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.blender import ray_caster as caster_module
from irpso_addon.blender.ray_caster import ray_caster, ray_caster_steps
from irpso_addon.core.steps import run_steps
from irpso_addon.geometry.light import light_transport as module
from irpso_addon.geometry.light.light_transport import light_transport_steps
from irpso_addon.geometry.surface.mesh import MeshData
from tests.builders.cavity import cavity, cavity_mesh

SHAPE = 96, 192
WIDTH = 2 * np.pi / 192 * 12  # of a cell of 12 texels on a sphere of radius 1


def scattered(mesh: MeshData, blocks=(12, 6), seed=1) -> MeshData:
    """Return a mesh whose UV map is cut into blocks, which are laid out in another order."""
    block = np.floor(mesh.uvs.mean(axis=1) * blocks).astype(int)
    number = block[:, 1] * blocks[0] + block[:, 0]
    other = np.random.default_rng(seed).permutation(blocks[0] * blocks[1])[number]
    moved = np.stack([other % blocks[0], other // blocks[0]], axis=-1) - block
    return replace(mesh, uvs=(mesh.uvs + (moved / blocks)[:, None]).astype(np.float32))


def transport_of(mesh: MeshData, resolution=16, rays=16):
    domain = cavity(mesh, SHAPE)
    steps = light_transport_steps(mesh, domain.bake, domain.lights, ray_caster(mesh), resolution, rays)
    return run_steps(steps), domain.bake


@pytest.mark.parametrize("cut", [False, True])
def test_texels_and_rays_have_elements_near_them_in_space(cut):
    mesh = cavity_mesh()
    transport, bake = transport_of(scattered(mesh) if cut else mesh)
    places = bake.position.reshape(-1, 3)[transport.texels]
    covered = bake.position[bake.coverage]
    chosen = transport.share > 0.01
    away = np.linalg.norm(places[transport.near] - covered[:, None], axis=-1)[chosen]
    assert away.max() < 4 * WIDTH
    assert np.quantile(away, 0.95) < 2 * WIDTH
    np.testing.assert_allclose(transport.share.sum(axis=-1), 1, atol=1e-6)
    hit = transport.hits >= 0
    assert hit.mean() > 0.99
    origin = np.broadcast_to(places, transport.directions.shape)[hit]
    direction = transport.directions[hit]
    met = origin - 2 * (origin * direction).sum(axis=-1, keepdims=True) * direction
    away = np.linalg.norm(places[transport.hits[hit]] - met, axis=-1)
    assert np.quantile(away, 0.99) < 2 * WIDTH


def test_an_island_beside_others_has_an_element_of_its_own():
    mesh = cavity_mesh()
    whole, cut = (transport_of(each)[0] for each in (mesh, scattered(mesh)))
    assert len(whole.texels) < len(cut.texels) < 3 * len(whole.texels)
    assert len(np.unique(cut.texels)) == len(cut.texels)


def test_each_udim_tile_has_as_many_elements_as_one_square():
    mesh = cavity_mesh()
    finer, _ = transport_of(mesh, resolution=32)
    tiles, _ = transport_of(replace(mesh, tiles=(1001, 1002)), resolution=16)
    np.testing.assert_array_equal(tiles.texels, finer.texels)
    np.testing.assert_array_equal(tiles.hits, finer.hits)
    np.testing.assert_array_equal(tiles.share, finer.share)


def test_where_there_are_too_few_elements_texels_get_no_light(monkeypatch):
    monkeypatch.setattr(module, "MAX_ELEMENTS", 1)
    transport, bake = transport_of(scattered(cavity_mesh()), resolution=3)
    assert len(transport.texels) == 9
    places, covered = bake.position.reshape(-1, 3)[transport.texels], bake.position[bake.coverage]
    total = transport.share.sum(axis=-1)
    assert 0.1 < (total == 0).mean() < 0.9
    away = np.linalg.norm(places[transport.near] - covered[:, None], axis=-1)[transport.share > 0]
    assert away.max() < 6 * 16 / 3 * WIDTH
    light = transport.at_texels(np.ones((9, 1)))
    np.testing.assert_array_equal(light[total == 0], 0)


def test_a_tree_is_made_in_pieces_and_rays_meet_the_same_triangles(monkeypatch):
    mesh = cavity_mesh()
    rays = np.random.default_rng(0).normal(size=(500, 3))
    origins = np.zeros_like(rays)
    at_once = ray_caster(mesh)(origins, rays)
    monkeypatch.setattr(caster_module, "_CHUNK", 100)
    assert len(list(ray_caster_steps(mesh))) > len(mesh.positions) / 100
    for one, other in zip(at_once, ray_caster(mesh)(origins, rays), strict=True):
        np.testing.assert_array_equal(one, other)
