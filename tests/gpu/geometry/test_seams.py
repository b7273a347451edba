"""Recoveries over UV seams: neighbours on the surface are neighbours, in tiles as in the whole, and in margins."""

from collections import Counter
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from irpso_addon.blender.materials.margins import blender_maps
from irpso_addon.blender.materials.tangent_frames import from_blender
from irpso_addon.geometry.domain import domain_of, with_samples
from irpso_addon.geometry.seams.seams import seams_of
from irpso_addon.geometry.surface.bake import bake_uv
from irpso_addon.gpu import context
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.map_tables import map_tables, map_values
from irpso_addon.results.maps import Maps
from irpso_addon.solver.engine.recovery import Recovery
from irpso_addon.solver.engine.tiled import TiledRecovery
from irpso_addon.solver.phases.phase import PhaseContext
from irpso_addon.solver.phases.synchronous_swarm import SynchronousSwarmPhase
from irpso_addon.solver.planning.cost import recovery_cost
from irpso_addon.solver.settings.refinement_groups import Refinement
from irpso_addon.solver.settings.resolve import resolve
from irpso_addon.solver.settings.schedule import load_schedule
from irpso_addon.solver.state.packing import Packing
from irpso_addon.solver.state.textures import DomainTextures, Estimates
from irpso_addon.solver.views.forward import Renderer
from tests.builders.balls import cap
from tests.builders.domains import SHORT, make_domain, pack_layers, random_truth, unit, with_radiance
from tests.builders.seams import part, sheet
from tests.oracles import swarm as oracle
from tests.oracles.geometry import joined

LAMBERT = load_model("lambert")
TWO_LOBES = load_model("cook_torrance_two_lobe")
RADIUS = 2


def observed(subject, observations=8, seed=3, holes=0.0, model="lambert"):
    """Return the domain of a sheet that is lit, and seen from above; with holes some texels are never seen."""
    rng = np.random.default_rng(seed)
    domain = subject.domain()
    shape = domain.shape
    lit = make_domain(*shape, observations=observations, holes=False, rng_seed=seed)
    truth = random_truth(rng, shape)
    stack = lit.stack.values.copy()
    stack[..., 3] *= domain.bake.coverage & (rng.uniform(size=shape) >= holes)
    domain = replace(with_samples(domain, stack), lights=lit.lights, intensities=lit.intensities, views=lit.views)
    return with_radiance(domain, model, truth)


@pytest.mark.parametrize("turn, search", [
    ("turned by 90°", "hemisphere"), ("mirrored", "hemisphere"), ("past the square's edge", "hemisphere"),
    ("mirrored, turned, three times as large", "cartesian"),
])  # fmt: skip
def test_the_mean_of_equation_4_goes_over_the_surface_with_normals_turned_between_frames(turn, search):
    context.ensure()
    subject = sheet(turn)
    domain = observed(subject, holes=0.1)
    schedule = load_schedule("standard").replaced(
        neighbourhood=2 * RADIUS + 1, normal=search, search=["normal"], linear="search", prefit_iterations=0, c3=0.3
    )
    stage = resolve(schedule, LAMBERT, set())[0]
    packing = Packing(domain.solvable, domain.seams)
    domain_textures = DomainTextures(
        domain, packing, pack_layers(packing, domain.stack.values), packing.pack(np.ones(domain.shape))
    )
    values = {p.name: np.zeros((*domain.shape, p.components)) for p in LAMBERT.parameters}
    estimates = Estimates(LAMBERT, {name: packing.pack(value) for name, value in values.items()})
    problem = oracle.Problem(domain, LAMBERT, stage, schedule, values, np.ones(domain.shape), 1)
    g = np.random.default_rng(5).uniform(0.2, 0.8, (*domain.shape, 4))
    phase = SynchronousSwarmPhase(stage, PhaseContext(LAMBERT, schedule, domain_textures, estimates, "fragment"), 1)
    phase.textures.ensure()
    phase.textures.upload("global_best", [packing.pack(g)])
    inputs = {**phase.textures.bindings(), **estimates.bindings(), **domain_textures.textures}
    phase.passes.mean.run(phase.textures.of("mean"), inputs, phase.constants())
    found = packing.unpack(phase.read("mean"))
    phase.close()

    frame, solvable = oracle.frames(domain.bake), domain.solvable
    checked = 0
    for y, x in np.argwhere(solvable)[::2]:
        window, sure, crossed = [], True, False
        for by in [(i, j) for j in range(-RADIUS, RADIUS + 1) for i in range(-RADIUS, RADIUS + 1)]:
            there = subject.neighbour((x, y), by)
            # What lies less than half a texel past the sheet's own border may be taken for what lies within it.
            sure &= there is not None or subject.outside((x, y), by) >= 0.5
            if there is not None and solvable[there[1], there[0]]:
                crossed |= subject.part_at(there) != subject.part_at((x, y))
                n = g[there[1], there[0]]
                turned = by != (0, 0)
                window.append(oracle._in_frame(problem, n, frame[there[1], there[0]], frame[y, x]) if turned else n)
        if sure and crossed:
            checked += 1
            count = problem.dimensions
            np.testing.assert_allclose(found[y, x, :count], np.mean(window, axis=0)[:count], atol=2e-6)
    assert checked > 10


BOXES = {
    "cutting both parts": [(0, 0, 11, 16), (11, 0, 51, 16), (0, 16, 30, 34), (30, 16, 32, 34)],
    "a part each": [(0, 0, 20, 50), (20, 0, 42, 50)],
}


def everything(maps):
    """Return all arrays of maps as bytes."""
    arrays = {**maps.values, "residual": maps.residual}
    return {name: np.ascontiguousarray(array).tobytes() for name, array in arrays.items()}


def whole_of(domain, model, schedule):
    """Return the maps' bytes of a recovery of the whole domain."""
    with Recovery(domain, model, schedule, 1, entry="fragment") as recovery:
        recovery.step()
        return everything(recovery.maps(confidence=False))


def tiled(domain, model, schedule, boxes, on_device=None):
    """Return a recovery of it in tiles, which see each other across the cut."""
    halo = recovery_cost(model, schedule, (), domain.observations).stencil_radius
    options = {"boxes": BOXES[boxes], "halo": halo, "on_device": on_device}
    recovery = TiledRecovery(domain, model, schedule, 1, entry="fragment", **options)
    assert sum(len(part.domain.seams.ghosts) for part in recovery._pool.tiles) > 8
    return recovery


def test_swapped_tiles_read_bests_across_a_cut_midway(tmp_path):
    schedule = SHORT.replaced(iterations=30, neighbour_interval=2, neighbourhood=5)
    domain = observed(sheet("mirrored and turned"), holes=0.1)
    whole = whole_of(domain, LAMBERT, schedule)
    assert whole_of(replace(domain, seams=None), LAMBERT, schedule) != whole
    with tiled(domain, LAMBERT, schedule, "cutting both parts", on_device=1) as recovery:
        recovery.step(iterations=3)
        recovery.save(tmp_path / "run")
    with tiled(domain, LAMBERT, schedule, "cutting both parts", on_device=1) as recovery:
        recovery.load(tmp_path / "run")
        recovery.step()
        assert everything(recovery.maps(confidence=False)) == whole


def test_tiles_spread_and_pool_across_a_cut_like_the_whole():
    schedule = load_schedule("standard").replaced(
        iterations=2, c3=0.3, prefit_iterations=0, prior_rounds=2, prior_scales=2,
        refinement=Refinement(iterations=2, starts=False, rounds=1, round_iterations=1),
    )  # fmt: skip
    domain = observed(sheet("mirrored and turned"), holes=0.1, model="cook_torrance_two_lobe")
    whole = whole_of(domain, TWO_LOBES, schedule)
    with tiled(domain, TWO_LOBES, schedule, "a part each") as recovery:
        recovery.step()
        assert everything(recovery.maps(confidence=False)) == whole


@pytest.mark.parametrize("turn", ["mirrored and turned", "three times as large"])
def test_a_margin_past_a_seam_holds_the_other_side_with_turned_normals(turn):
    subject, leaning = sheet(turn), unit(np.array([0.3, 0.2, 0.9]))
    domain = subject.domain()
    covered = domain.bake.coverage

    def color(part, place):  # linear over the sheet: between texels nothing is lost
        s, t = subject._sheet(part, np.array(place) + 0.5)
        # Between the other side's last texel and the cut it goes on as it ends.
        last = -0.5 if part else 0.5 / abs(subject.turn).max()
        ends = last if 0 < s / last < 1 else s
        return 0.5 + 0.01 * ends, 0.5 + 0.02 * t, 0.3

    colors = np.zeros((*domain.shape, 3), np.float32)
    for y, x in np.argwhere(covered):
        colors[y, x] = color(subject.part_at((x, y)), (x, y))
    # Normals that lean away alike from the sheet, which bends about y.
    sine, cosine = domain.bake.normal[..., 0], domain.bake.normal[..., 2]
    x, y, z = leaning
    world = np.stack([cosine * x + sine * z, y + 0 * sine, cosine * z - sine * x], axis=-1)
    normals = np.einsum("hwij,hwj->hwi", domain.bake.frames(), world).astype(np.float32)
    maps = Maps(LAMBERT, {"base_color": colors, "normal": normals}, covered)
    written = blender_maps(maps, subject.mesh, domain.bake, domain.seams)
    (table,) = [table for table in map_tables(LAMBERT) if table.name == "base_color"]
    pixels = map_values(table, written)
    places = np.argwhere(written.margin)
    assert len(places) > 60 and not covered[written.margin].any()
    texels = np.argwhere(covered)
    beside = texels[((places[:, None] - texels) ** 2).sum(axis=-1).argmin(axis=1)]
    inner = 0
    for (y, x), (near_y, near_x) in zip(places, beside, strict=True):
        by = (x - near_x, y - near_y)
        if subject.outside((near_x, near_y), by) > -1:
            continue  # at the sheet's own border fewer than four texels tell
        inner += 1
        np.testing.assert_allclose(pixels[y, x], color(subject.part_at((near_x, near_y)), (x, y)), atol=1e-4)
    assert inner > 40
    there = np.zeros((*domain.shape, 3), np.float32)
    there[beside[:, 0], beside[:, 1]] = written.values["normal"][places[:, 0], places[:, 1]]
    read = from_blender(subject.mesh, domain.bake, there)[beside[:, 0], beside[:, 1]]
    frames = domain.bake.frames()[beside[:, 0], beside[:, 1]]
    wanted = world[beside[:, 0], beside[:, 1]]
    np.testing.assert_allclose(np.einsum("nij,ni->nj", frames, read), wanted, atol=1e-3)


def test_a_margin_past_an_unsolved_seam_comes_from_its_own_side():
    subject = sheet("turned by 90°")
    domain = subject.domain()
    covered = domain.bake.coverage & (np.arange(domain.shape[1]) < 20)  # the left part alone
    values = {"base_color": np.full((*domain.shape, 3), 0.25), "normal": np.zeros((*domain.shape, 3)) + (0, 0, 1)}
    written = blender_maps(Maps(LAMBERT, values, covered), subject.mesh, domain.bake, domain.seams)
    assert not written.margin.any()


SEEDS = 1, 2, 3  # the steps at the cut of one run are few and scatter
ACROSS, ALONG, PLACE = 16, 44, (40, 3)  # texels of either part of a larger sheet, and the right part's corner, mirrored
ROWS, COLUMNS = 50, 44
PRINCIPLED = load_model("principled")


@pytest.fixture(scope="module")
def noisy():
    """A domain of a sheet cut in two, where six lights tell little of the gloss; (s, t) of each texel; the truth."""
    context.ensure()
    mesh = joined(
        part(np.arange(-ACROSS, 1), lambda st: st + (3 + ACROSS, 3), ALONG, (ROWS, COLUMNS)),
        part(np.arange(ACROSS + 1), lambda st: st * (-1, 1) + PLACE, ALONG, (ROWS, COLUMNS)),
    )
    bake = bake_uv(mesh, COLUMNS, ROWS)
    y, x = np.mgrid[:ROWS, :COLUMNS] + 0.5
    s, t = np.where(x < 3 + ACROSS, x - 3 - ACROSS, PLACE[0] - x), y - 3
    color = np.stack([0.5 + 0.2 * np.sin(s / 7), 0.45 + 0.15 * np.sin(s / 5 + t / 11), 0.4 + 0 * s], axis=-1)
    relief = bake.normal + 0.2 * np.stack([np.sin(s / 3 + t / 5), np.sin(t / 3), 0 * s], axis=-1)
    normal = np.einsum("hwij,hwj->hwi", bake.frames(), unit(relief))
    gloss = np.full((ROWS, COLUMNS, 1), 0.4)
    truth = {"base_color": color, "normal": normal, "roughness": gloss, "specular": gloss + 0.1}
    truth = {name: value.astype(np.float32) for name, value in truth.items()}
    lights = np.pad(np.float32(cap(6, 55)), ((0, 0), (0, 1)))
    rows = lights, np.ones((6, 3), np.float32), np.tile(np.float32([0, 0, 1, 0]), (6, 1))
    renderer = Renderer(bake, PRINCIPLED, truth, *rows)
    stack = np.stack([renderer.render(k) for k in range(6)])
    renderer.close()
    noise = np.random.default_rng(1).normal(0, 0.02, stack[..., :3].shape)
    stack[..., :3] = np.maximum(stack[..., :3] + noise, 0)
    stack[..., 3] = bake.coverage
    domain = domain_of(bake, stack, *rows, card=False, seams=seams_of(mesh, bake.triangle))
    return domain, s, t, truth


def test_errors_near_a_seam_are_no_larger_than_elsewhere(noisy):
    domain, s, t, truth = noisy
    steps, errors = Counter(), Counter()
    subjects = {"off": replace(domain, seams=None), "on": domain}
    inner = domain.bake.coverage & (np.abs(t - ALONG / 2) < ALONG / 2 - 5) & (np.abs(s) < ACROSS - 5)
    for name, seed in product(subjects, SEEDS):
        with Recovery(subjects[name], PRINCIPLED, load_schedule("standard"), seed, entry="fragment") as recovery:
            recovery.step()
            found = recovery.maps(confidence=False).values
        for map_name, value in found.items():
            error = np.linalg.norm(value - truth[map_name], axis=-1)
            errors[name, map_name, "near"] += error[inner & (np.abs(s) <= 4)].mean()
            errors[name, map_name, "elsewhere"] += error[inner & (np.abs(s) > 4)].mean()
        # Within 3 texels of the cut, row by row: the gloss is the same all over.
        mean = [[found["specular"][(np.floor(t) == row) & inner & (side * s > 0) & (np.abs(s) < 3)].mean()
                 for row in range(5, ALONG - 5)] for side in (-1, 1)]  # fmt: skip
        steps[name] += np.abs(np.subtract(*mean)).mean()
    for map_name in truth:
        # Six lights tell little of the specular: its error near the cut scatters by a fifth, with seams or without.
        assert errors["on", map_name, "near"] <= 1.3 * errors["on", map_name, "elsewhere"], errors
        assert errors["on", map_name, "near"] <= 1.1 * errors["off", map_name, "near"], errors
    assert steps["on"] < 0.8 * steps["off"], steps
