"""Coarser domains: every cell against loops in float64, maps down and up between tangent frames."""

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.geometry.coarsen import coarser, coarser_map, finer_map
from irpso_addon.geometry.domain import tile
from irpso_addon.geometry.samples import place_of
from tests.builders.domains import make_domain, unit
from tests.oracles.swarm import frames


def cell_of(domain, y, x):
    """The rows and columns of the covered texels under a coarse one."""
    height, width = domain.shape
    under = [(2 * y + i, 2 * x + j) for i in range(2) for j in range(2)]
    return [(r, c) for r, c in under if r < height and c < width and domain.bake.coverage[r, c]]


@pytest.mark.parametrize(("height", "width"), [(8, 6), (7, 9)])
@pytest.mark.parametrize("card", [True, False])
def test_a_coarse_texel_is_the_weighted_mean_of_the_covered_ones_under_it(height, width, card):
    domain = replace(make_domain(height, width, card=card, perspective=True), origin=(6, 2), noise=0.01)
    coarse = coarser(domain)
    assert coarse.shape == (-(-height // 2), -(-width // 2)) and coarse.card == card
    assert coarse.origin == (3, 1) and coarse.noise == 0.01
    for y, x in np.ndindex(coarse.shape):
        under = cell_of(domain, y, x)
        assert coarse.bake.coverage[y, x] == bool(under)
        if not under:
            assert (coarse.stack.values[:, y, x, 3] == 0).all()
            continue
        position = np.mean([domain.bake.position[at].astype(np.float64) for at in under], axis=0)
        np.testing.assert_allclose(coarse.bake.position[y, x], position, atol=1e-6)
        for k in range(domain.observations):
            samples = np.array([domain.stack.values[(k, *at)] for at in under], np.float64)
            assert coarse.stack.values[k, y, x, 3] == pytest.approx(samples[:, 3].mean(), abs=1e-6)
            counted = samples[samples[:, 3] > 0]
            finite = samples[np.isfinite(samples).all(axis=1), :3]
            plain = finite.mean(axis=0) if len(finite) else 0
            wanted = (counted[:, :3] * counted[:, 3:]).sum(axis=0) / counted[:, 3].sum() if len(counted) else plain
            np.testing.assert_allclose(coarse.stack.values[k, y, x, :3], wanted, atol=1e-6)
    assert np.isfinite(coarse.stack.values).all()


def test_clipped_texels_alone_make_a_lower_bound_in_their_channels():
    domain = make_domain(2, 4)
    domain.bake.coverage[:] = True
    layer = domain.stack.layer(0)
    layer[...] = (0.5, 0.6, 0.7, 1.0)
    layer[:, 2:] = (0.9, 1.0, 0.7, -(2 + 1.0 / 2))  # green is clipped
    layer[0, 2] = (0.5, 1.0, 0.5, -(3 + 0.5 / 2))  # red and green, its weight a half
    layer[0, 0] = (0.9, 1.0, 0.7, -(2 + 1.0 / 2))  # one among others
    mixed, bound = coarser(domain).stack.layer(0)[0]
    np.testing.assert_allclose(mixed, (0.5, 0.6, 0.7, 3 / 4), rtol=1e-6)
    weight = 3.5 / 4
    np.testing.assert_allclose(bound, ((2.7 + 0.25) / 3.5, 1.0, (2.1 + 0.25) / 3.5, -(3 + weight / 2)), rtol=1e-6)


def test_a_coarse_texel_without_weight_shows_the_mean_of_its_photographed_texels():
    domain = make_domain(4, 4, holes=False)
    domain.stack.values[1, :2, :2] = [[(0.2, 0.4, 0.6, 0), (0.4, 0.4, 0.8, 0)], [(0.3, 0.4, 0.7, 0), (np.nan, 0, 0, 0)]]
    np.testing.assert_allclose(coarser(domain).stack.values[1, 0, 0], [0.3, 0.4, 0.7, 0], atol=1e-6)


def test_a_coarse_frame_is_orthonormal_and_keeps_the_hand_of_the_first_texel_covered():
    domain = make_domain(12, 14, card=False)
    bake = coarser(domain).bake
    for y, x in np.argwhere(bake.coverage):
        under = cell_of(domain, y, x)
        normal = np.mean([domain.bake.normal[at].astype(np.float64) for at in under], axis=0)
        np.testing.assert_allclose(bake.normal[y, x], unit(normal), atol=1e-6)
        assert bake.tangent[y, x, 3] == domain.bake.tangent[under[0]][3]
        alike = [domain.bake.tangent[at].astype(np.float64) for at in under]
        mean = np.mean([t[:3] for t in alike if t[3] == alike[0][3]], axis=0)
        across = mean - (mean @ unit(normal)) * unit(normal)
        np.testing.assert_allclose(bake.tangent[y, x, :3], unit(across), atol=1e-5)


def test_opposite_normals_leave_the_first_one_and_a_tangent_across_it():
    domain = make_domain(2, 2, card=False, holes=False)
    normal = np.float32([[(0, 0, 1), (0, 0, -1)], [(0, 0, -1), (0, 0, 1)]])
    tangent = np.tile(np.float32([0, 0, 1, -1]), (2, 2, 1))
    bake = coarser(replace(domain, bake=replace(domain.bake, normal=normal, tangent=tangent))).bake
    np.testing.assert_array_equal(bake.normal[0, 0], (0, 0, 1))
    assert np.linalg.norm(bake.tangent[0, 0, :3]) == pytest.approx(1) and bake.tangent[0, 0, 2] == 0
    assert bake.tangent[0, 0, 3] == -1


def test_a_tile_with_a_halo_is_refused():
    with pytest.raises(ValueError, match="halo"):
        coarser(tile(make_domain(8, 8), 2, 2, 4, 4, halo=1))


def test_a_constant_world_normal_survives_down_and_upsampling_in_turned_frames():
    domain = make_domain(9, 10, card=False, rng_seed=5)
    coarse = coarser(domain)
    world = unit(np.array([0.1, -0.2, 1.0]))

    def local(bake):
        return np.einsum("hwij,j->hwi", frames(bake), world)

    fine, below = local(domain.bake), local(coarse.bake)
    down = coarser_map(domain, coarse, fine, normal=True)
    facing = coarse.bake.coverage & (below[..., 2] > 0)
    np.testing.assert_allclose(down[facing], below[facing], atol=1e-5)
    up = finer_map(coarse, domain, below, np.array([0, 0, 1.0]), normal=True)
    seen = domain.solvable & (fine[..., 2] > 0)
    np.testing.assert_allclose(up[seen], fine[seen], atol=1e-5)
    assert seen.sum() > 40 and facing.sum() > 10


def test_maps_go_up_bilinearly_between_solvable_texels_only():
    domain = make_domain(7, 9, holes=True, rng_seed=2)
    domain.stack.values[:, 2:4, 4:6] = (np.nan, np.nan, np.nan, 0)
    domain.bake.coverage[2:4, 4:6] = True
    coarse = coarser(domain)
    values = np.random.default_rng(0).uniform(size=(*coarse.shape, 2))
    values[~coarse.solvable] = np.nan
    found = finer_map(coarse, domain, values, -7.0)
    for y, x in np.ndindex(domain.shape):
        total, weights = 0.0, 0.0
        for (r, c), solvable in np.ndenumerate(coarse.solvable):
            away = abs((y + 0.5) / 2 - (r + 0.5)), abs((x + 0.5) / 2 - (c + 0.5))
            weight = max(0.0, 1 - away[0]) * max(0.0, 1 - away[1]) * solvable
            total, weights = total + (weight * values[r, c] if weight else 0), weights + weight
        np.testing.assert_allclose(found[y, x], total / weights if weights else -7.0, atol=1e-6)


def test_coarse_samples_lie_in_a_scratch_file_where_the_plan_says_so(tmp_path):
    domain = make_domain(7, 9)
    stacks = [coarser(domain, folder).stack for folder in (None, tmp_path)]
    assert [place_of(stack) for stack in stacks] == ["memory", "scratch"]
    np.testing.assert_array_equal(stacks[0].values, stacks[1].values)
