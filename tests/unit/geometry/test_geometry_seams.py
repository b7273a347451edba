"""Seam maps against sheets cut in two, of which every neighbour on the surface is known."""

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.geometry.coarsen import coarser, finer_map
from irpso_addon.geometry.domain import domain_of, tile
from irpso_addon.geometry.seams.edges import seam_edges
from irpso_addon.geometry.seams.seams import seams_of
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.planning.cost import recovery_cost
from irpso_addon.solver.planning.plan import Borders, tile_of
from irpso_addon.solver.settings.schedule import load_schedule
from irpso_addon.solver.state.packing import Packing
from tests.builders.seams import LEFT, START, TURNS, sheet
from tests.oracles.geometry import bake_uv, joined, mesh_from_corners


def looked_up(seams, texel, by):
    """Return the texel (x, y) that a seam map tells, None where there is none: what shaders do, written plainly."""
    place, chart = (texel[0] + by[0], texel[1] + by[1]), seams.chart[texel[1], texel[0]]
    height, width = seams.shape
    inside = 0 <= place[0] < width and 0 <= place[1] < height
    if inside and seams.chart[place[1], place[0]] in (chart, seams.island[texel[1], texel[0]]):
        return place
    entry = np.flatnonzero((seams.place == place).all(axis=1) & (seams.of == chart))
    assert len(entry) <= 1
    return tuple(int(c) for c in np.divmod(seams.target[entry[0]], width)[::-1]) if len(entry) else None


@pytest.mark.parametrize("turn", TURNS)
def test_past_a_cut_lies_the_continuing_sheet(turn):
    subject = sheet(turn)
    seams = subject.domain().seams
    assert len(np.unique(seams.island)) == 3 and subject.bake.coverage[subject.bake.coverage].size > 200
    crossed = 0
    for x, y in np.argwhere(subject.bake.coverage.T)[::9]:
        for by in [(1, 0), (-1, 0), (0, 1), (0, -1), (2, 1), (-2, -1), (3, -3), (-5, 4), (7, 0), (0, -9), (-12, 3)]:
            wanted = subject.neighbour((x, y), by)
            found = looked_up(seams, (x, y), by)
            if wanted is None and found is not None:  # no farther off than a larger texel's rounding
                assert subject.outside((x, y), by) < 0.5
                continue
            assert found == wanted, (x, y, by)
            crossed += wanted is not None and subject.part_at(wanted) != subject.part_at((x, y))
    assert crossed > 20


def test_adjacent_islands_and_open_borders_have_no_neighbours():
    def strip(x0, z):
        p = np.array([[[0, 0, z], [8, 0, z], [8, 16, z]], [[0, 0, z], [8, 16, z], [0, 16, z]]], float)
        normals = np.zeros((2, 3, 3)) + (0, 0, 1)
        return mesh_from_corners(p, normals, np.zeros((2, 3, 4)) + (1, 0, 0, 1), (p[..., :2] + (x0, 4)) / 32)

    mesh = joined(strip(4, 0.0), strip(12, 9.0))  # the second one begins where the first one ends
    edges, islands = seam_edges(mesh, 32, 32)
    assert islands.tolist() == [0, 0, 1, 1] and (edges.other == -1).all() and len(edges.start) == 8
    triangle = np.full((32, 32), -1)
    triangle[4:20, 4:12], triangle[4:20, 12:20] = 0, 2
    seams = seams_of(mesh, triangle)
    assert not len(seams.place)
    assert looked_up(seams, (11, 8), (1, 0)) is None and looked_up(seams, (11, 8), (-1, 0)) == (10, 8)
    assert looked_up(seams, (12, 8), (-1, 0)) is None


def test_corners_are_merged_within_rounding_and_non_manifold_edges_are_borders():
    p = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 0], [1, 0, 0], [1, 1, 0]]], float)
    uv = p[..., :2] * 0.5 + 0.25
    uv[1] += 1e-5
    frames = np.zeros((2, 3, 3)) + (0, 0, 1), np.zeros((2, 3, 4)) + (1, 0, 0, 1)
    flat = mesh_from_corners(p, *frames, uv)
    edges, islands = seam_edges(flat, 64, 64)
    assert islands.tolist() == [0, 0] and len(edges.start) == 4
    edges, islands = seam_edges(flat, 4096, 4096)
    assert islands.tolist() == [0, 1] and (edges.other >= 0).sum() == 2
    third = mesh_from_corners([[[0, 1, 0], [1, 0, 0], [0.5, 0.5, 1]]], *(f[:1] for f in frames), uv[:1] + 0.2)
    edges, islands = seam_edges(joined(flat, third), 64, 64)
    assert len(np.unique(islands)) > 1 and (edges.other == -1).all()


ARM, GAP, LONG, FOOT = 9, 3, 36, 6  # texels
CORNER = (4, 5)  # the foot's first texel


def two_arms(sewn):
    """Return the seams of an island like a U, radius 4; sewn: whether the arms' inner edges are one on the surface."""
    x, y = np.meshgrid(np.arange(2 * ARM + GAP + 1.0), np.arange(-FOOT, LONG + 1.0))
    bent = np.where((x >= ARM + GAP) & sewn, GAP * np.clip(y, 0, 1), 0)
    points = np.stack([x - bent, y, 0 * x], axis=-1)
    uv = (np.stack([x, y + FOOT], axis=-1) + CORNER) / (40, 64)

    def triangles(values):
        a, b, c, d = values[:-1, :-1], values[:-1, 1:], values[1:, 1:], values[1:, :-1]
        gap = (x[:-1, :-1] >= ARM) & (x[:-1, :-1] < ARM + GAP) & (y[:-1, :-1] >= 0)
        quads = np.stack([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)], axis=2)[~gap]
        return quads.reshape(-1, 3, values.shape[-1])

    frames = np.zeros((*x.shape, 3)) + (0, 0, 1), np.zeros((*x.shape, 4)) + (1, 0, 0, 1)
    mesh = mesh_from_corners(*(triangles(v) for v in (points, *frames, uv)))
    bake = bake_uv(mesh, 40, 64)[0]
    return seams_of(mesh, bake.triangle, radius=4), bake


def arms_domain():
    """Return a domain of the arms sewn together, of one dark observation."""
    seams, bake = two_arms(True)
    rows = (np.float32([[0, 0, 1, 0]]), np.float32([[1, 1, 1]]), np.float32([[0, 0, 1, 0]]))
    return domain_of(bake, np.ones((1, 64, 40, 4), np.float32), *rows, card=False, seams=seams)


@pytest.mark.parametrize("sewn", [False, True])
def test_sides_of_a_gap_are_neighbours_only_where_connected(sewn):
    seams, _ = two_arms(sewn)
    assert (seams.island >= 0).sum() == 2 * ARM * LONG + FOOT * (2 * ARM + GAP) and seams.island.max() == 0
    left, right = CORNER[0] + ARM - 1, CORNER[0] + ARM + GAP  # the columns along the gap
    bottom = CORNER[1] + FOOT
    for y in range(bottom + 16, bottom + LONG - 5):  # farther from the foot than three blocks and a radius
        for by in [(x, dy) for x in range(-4, 5) for dy in (-3, 0, 2)]:
            for column, step in ((left, 1), (left - 2, 1), (right, -1), (right + 1, -1)):
                across = (left - column if step > 0 else column - right) < step * by[0]
                shift = step * GAP if across and sewn else 0
                wanted = (column + by[0] + shift, y + by[1]) if not across or sewn else None
                assert looked_up(seams, (column, y), by) == wanted, (column, y, by)
    for y in range(CORNER[1], bottom):  # in the foot all lie side by side
        assert looked_up(seams, (left, y), (4, 0)) == (left + 4, y)
    # Where the gap ends, both arms see the foot, and it sees them.
    assert looked_up(seams, (left, bottom + 1), (0, -3)) == (left, bottom - 2)
    assert looked_up(seams, (right, bottom - 1), (1, 4)) == (right + 1, bottom + 3)


@pytest.mark.parametrize("turn", ["turned by 180°", "mirrored and turned"])
def test_at_half_the_size_the_same_surface_lies_across_a_cut(turn):
    subject = sheet(turn)
    domain = coarser(subject.domain())
    seams = domain.seams
    assert seams.island.shape == domain.shape and ((seams.island >= 0) == domain.bake.coverage).all()
    left = seams.of == seams.island[START[1] // 2 + 1, START[0] // 2 + 1]
    middle = 2 * (seams.place[left] + 0.5)
    wanted = (middle - START - (LEFT, 0)) @ subject.turn.T + subject.origin
    assert left.sum() > 30 and (~left).sum() > 30
    np.testing.assert_allclose(2 * seams.at[left], wanted, atol=0.02)
    y, x = np.divmod(seams.target[left], domain.shape[1])
    assert np.abs(2 * np.stack([x + 0.5, y + 0.5], axis=-1) - wanted).max() < 2.01
    assert (seams.island[y, x] == seams.of[~left][0]).all()


def test_upsampling_does_not_mix_adjacent_islands():
    domain = sheet("as it is").domain()
    island = np.where(domain.bake.coverage, (np.arange(domain.shape[1]) >= 9) + 2 * (domain.seams.island > 0), -1)
    domain = replace(domain, seams=replace(domain.seams, island=island.astype(np.int32)))
    coarse = coarser(domain)
    fine = finer_map(coarse, domain, coarse.seams.island[..., None], 0.5)[..., 0]
    # Column 8 is of the one island and 9 of the other, and one coarse texel holds both.
    np.testing.assert_allclose(fine[domain.bake.coverage], island[domain.bake.coverage], atol=1e-4)


@pytest.mark.parametrize("turn", ["mirrored and turned", "past the square's edge", "two arms"])
def test_a_tile_reads_across_seams_like_the_whole(turn):
    whole = arms_domain() if turn == "two arms" else sheet(turn).domain(radius=6)
    reached, met = 3, 0
    rows, columns = whole.shape
    for x0, y0, x1, y1 in ((0, 0, 20, 20), (20, 0, columns, 20), (0, 20, 14, rows), (14, 20, columns, rows)):
        part = tile(whole, x0, y0, x1 - x0, y1 - y0, halo=reached)
        high, wide = part.shape
        for y, x in np.argwhere(part.solvable)[::5]:
            if not (part.halo[0] <= x < wide - part.halo[1] and part.halo[2] <= y < high - part.halo[3]):
                continue
            for by in [(1, 0), (-3, 0), (0, 2), (0, -1), (3, 3), (2, -3)]:
                at = x + part.origin[0], y + part.origin[1]
                entry = np.flatnonzero((part.seams.place == (x + by[0], y + by[1])).all(axis=1)
                                       & (part.seams.of == part.seams.chart[y, x]))  # fmt: skip
                wanted = looked_up(whole.seams, at, by)
                if not len(entry):  # it lies there, or nowhere
                    near = part.seams.chart[y, x], part.seams.island[y, x]
                    inside = 0 <= x + by[0] < wide and 0 <= y + by[1] < high
                    direct = inside and part.seams.chart[y + by[1], x + by[0]] in near
                    assert wanted == ((at[0] + by[0], at[1] + by[1]) if direct else None)
                    continue
                target = part.seams.target[entry[0]]
                if target >= high * wide:
                    k, met = target - high * wide, met + 1
                    assert tuple(part.seams.ghosts[k]) == wanted
                    np.testing.assert_array_equal(part.seams.ghost_normal[k], whole.bake.normal[wanted[1], wanted[0]])
                    np.testing.assert_array_equal(part.seams.ghost_tangent[k], whole.bake.tangent[wanted[1], wanted[0]])
                else:
                    assert (target % wide + part.origin[0], target // wide + part.origin[1]) == wanted
    assert met > 5


@pytest.mark.parametrize(
    "preset, model, stencil_radius, most", [("swarm", "lambert", 1, 1.2), ("standard", "principled", 16, 2)]
)
def test_a_plan_includes_the_bytes_of_seams(preset, model, stencil_radius, most):
    domain = sheet("mirrored and turned").domain()
    edges = domain.seams.edges.some(domain.seams.edges.other >= 0)
    borders = Borders((edges.start + edges.end) / 2, np.linalg.norm(edges.end - edges.start, axis=-1))
    need = recovery_cost(load_model(model), load_schedule(preset).without_rounds(), (), 8)
    assert need.stencil_radius == stencil_radius
    boxes = [(0, 0, 20, 50), (20, 0, 42, 50)]
    for chosen in (boxes, [(0, 0, 62, 50)]):
        for box in chosen:
            planned = tile_of(domain.solvable, box, need, borders)
            part = tile(domain, *box, halo=need.stencil_radius) if len(chosen) > 1 else domain
            packing = Packing(part.solvable, part.seams)
            held = sum(array.nbytes for array in packing.arrays())
            places = packing.width * packing.height
            taken = places * (need.device - 16) + held + 48 * 8  # 16 bytes of the place are in ``held``
            assert taken <= planned.device <= most * taken
