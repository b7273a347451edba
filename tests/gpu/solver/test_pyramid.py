"""Coarse to fine: what one level leaves to the next, and the same maps however a run is sliced or interrupted."""

import functools

import numpy as np
import pytest

from irpso_addon.core.errors import InputError
from irpso_addon.geometry.coarsen import coarser
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.engine.coarse_to_fine import Pyramid
from irpso_addon.solver.engine.recovery import Recovery
from irpso_addon.solver.engine.tiled import TiledRecovery
from irpso_addon.solver.planning import make_plan as planning
from irpso_addon.solver.settings.levels import level_schedules
from irpso_addon.solver.settings.schedule import load_schedule
from tests.builders.domains import bits_of, make_domain, masked, subject, unit, with_radiance
from tests.oracles.swarm import frames

LAMBERT = load_model("lambert")
PRESETS = {
    "swarm": load_schedule("swarm").replaced(iterations=12),
    "standard": load_schedule("standard"),
    "paper": load_schedule("paper").replaced(iterations=8, cycles=1, particles=6),
}


def found(domain, schedule, fixed=None, drive=lambda run: run.step()):
    with Pyramid(domain, LAMBERT, schedule, 1, fixed, "fragment") as run:
        drive(run)
        assert run.progress.done and run.progress.fraction == 1
        return run.maps(), run.progress


def angles(a, b):
    return np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=-1) / 2, 0, 1)))


@pytest.fixture(scope="module")
def turned():
    """(domain of turned frames and holes, truth) whose world normals and colour vary slowly over 16×18 texels."""
    domain = make_domain(16, 18, observations=20, card=False)
    y, x = np.mgrid[:16, :18] / 16
    world = unit(np.stack([0.3 * np.sin(2 * x), 0.3 * np.cos(2 * y), np.ones_like(x)], axis=-1))
    local = np.einsum("hwij,hwj->hwi", frames(domain.bake), world)
    color = np.broadcast_to(np.stack([0.3 + 0.2 * x, 0.5 + 0.2 * y, 0.6 - 0.2 * x], axis=-1), (16, 18, 3))
    facing = local[..., 2] > 0.2
    domain = masked(domain, facing)
    truth = {"base_color": color.astype(np.float32), "normal": local.astype(np.float32)}
    return with_radiance(domain, "lambert", truth), truth


@pytest.fixture(scope="module")
def whole(turned):
    """Return preset → (maps, progress) of three levels in one step, each solved once."""
    return functools.cache(lambda preset: found(turned[0], PRESETS[preset].replaced(levels=3)))


@pytest.mark.parametrize("preset", PRESETS)
def test_one_level_is_the_recovery_bit_for_bit(preset):
    domain, _ = subject(observations=12)
    with Recovery(domain, LAMBERT, PRESETS[preset], 1, entry="fragment") as recovery:
        recovery.step()
        wanted, progress = recovery.maps(), recovery.progress
    maps, reported = found(domain, PRESETS[preset])
    assert bits_of(maps) == bits_of(wanted) and reported == progress
    assert maps.residual.tobytes() == wanted.residual.tobytes()


def one_by_one(run):
    while not run.step(iterations=1).done:
        pass


def in_uneven_steps(run):
    for n in (0, 5, 0, 9, 1, 20):
        run.step(iterations=n)
    run.step()


def in_tiny_slices(run):
    slices = 0
    while not run.step(time_budget_s=1e-6).done:
        slices += 1
        if slices % 9 == 0:
            run.maps()
    assert slices > 30


@pytest.mark.parametrize("drive", [one_by_one, in_uneven_steps, in_tiny_slices])
@pytest.mark.parametrize("preset", PRESETS)
def test_stepping_does_not_change_the_maps(turned, whole, preset, drive):
    wanted, progress = whole(preset)
    maps, reported = found(turned[0], PRESETS[preset].replaced(levels=3), drive=drive)
    assert bits_of(maps) == bits_of(wanted) and reported == progress


def test_a_step_makes_the_requested_iterations_across_levels(turned):
    schedule = PRESETS["swarm"].replaced(levels=3, level_iterations=0.5)
    with Pyramid(turned[0], LAMBERT, schedule, 1, entry="fragment") as run:
        assert run.step(iterations=0).iteration_in_all == 0
        assert run.step(iterations=11).title == "base_color + normal at 1/4"
        progress = run.step(iterations=3)
        assert (progress.iteration_in_all, progress.iteration, progress.iterations_in_all) == (14, 2, 24)
        assert progress.title == "base_color + normal at 1/2" and (progress.stage, progress.stages) == (1, 3)
        assert run.step(iterations=6).title == "base_color + normal"
        sizes = [d.solvable.sum() for d in (coarser(coarser(turned[0])), coarser(turned[0]), turned[0])]
        assert run.progress.fraction == pytest.approx(
            (28 * sizes[0] + 22 * sizes[1] + 18 * sizes[2]) / (28 * sizes[0] + 22 * sizes[1] + 22 * sizes[2])
        )
        particles = 16
        assert run.step().evaluations == sum((particles + n) * size for n, size in zip((12, 6, 6), sizes, strict=True))


@pytest.mark.parametrize("preset", PRESETS)
def test_a_run_resumes_from_a_checkpoint_of_any_level(turned, whole, tmp_path, preset):
    schedule = PRESETS[preset].replaced(levels=3)
    wanted, progress = whole(preset)
    every, file = progress.iterations_in_all // 6, tmp_path / "checkpoint.npz"
    run, levels, note = Pyramid(turned[0], LAMBERT, schedule, 1, entry="fragment"), set(), np.arange(3)
    while not run.step(iterations=every).done:
        levels.add(run.progress.title.partition(" at ")[2])
        run.save(file, {"mine": note})
        before = run.progress, bits_of(run.maps())
        run.close()
        run = Pyramid(turned[0], LAMBERT, schedule, 1, entry="fragment")
        assert run.load(file)["mine"].tolist() == note.tolist()
        assert (run.progress, bits_of(run.maps())) == before
    assert levels == {"1/4", "1/2", ""}
    assert bits_of(run.maps()) == bits_of(wanted) and run.progress.evaluations == progress.evaluations
    run.close()


def test_a_checkpoint_of_other_levels_is_refused(turned, tmp_path):
    file = tmp_path / "checkpoint.npz"
    with Pyramid(turned[0], LAMBERT, PRESETS["swarm"].replaced(levels=2), 1, entry="fragment") as run:
        run.save(file)
    other = PRESETS["swarm"].replaced(levels=3)
    with Pyramid(turned[0], LAMBERT, other, 1, entry="fragment") as run, pytest.raises(InputError, match="preset"):
        run.load(file)


def test_levels_do_not_change_a_uniform_subject():
    domain = make_domain(13, 11, observations=20, holes=False)
    truth = {
        "base_color": np.broadcast_to(np.float32([0.3, 0.5, 0.7]), (13, 11, 3)),
        "normal": np.broadcast_to(np.float32([0.2, -0.3, np.sqrt(1 - 0.13)]), (13, 11, 3)),
    }
    domain = with_radiance(domain, "lambert", truth)
    for levels in (1, 3):
        maps, _ = found(domain, PRESETS["standard"].replaced(levels=levels))
        np.testing.assert_allclose(maps.values["base_color"], truth["base_color"], atol=1e-4)
        assert angles(maps.values["normal"], truth["normal"]).max() < 0.02


def test_the_next_level_begins_where_the_coarse_one_ended_in_turned_frames(turned):
    domain, truth = turned
    schedule = PRESETS["standard"].replaced(levels=2)
    with Pyramid(domain, LAMBERT, schedule, 1, entry="fragment") as run:
        while " at 1/2" in run.progress.title:
            run.step(iterations=1)
        with run.view() as lent:
            assert lent["u_estimate_0"].width == int(np.ceil(np.sqrt(domain.solvable.sum())))
        begun = run.maps(confidence=False)
    solved = domain.solvable
    # Normals change by about 2° from texel to texel, and their frames by tens of degrees.
    assert np.median(angles(begun.values["normal"], truth["normal"])[solved]) < 1.5
    assert np.median(np.abs(begun.values["base_color"] - truth["base_color"])[solved]) < 0.02


def test_maps_of_a_coarse_level_have_the_size_of_the_domain(turned):
    domain, truth = turned
    with Pyramid(domain, LAMBERT, PRESETS["standard"].replaced(levels=3), 1, entry="fragment") as run:
        while " at 1/4" in run.progress.title:
            last = run.maps()
            run.step(iterations=1)
    assert (last.solved == domain.solvable).all() and last.residual.shape == domain.shape
    assert last.confidence["base_color"].shape == (*domain.shape, 3)
    assert np.median(angles(last.values["normal"], truth["normal"])[domain.solvable]) < 5


def test_fixed_parameters_are_fixed_at_every_level(turned):
    domain, truth = turned
    schedule = PRESETS["swarm"].replaced(levels=3, iterations=40)
    maps, _ = found(domain, schedule, fixed={"normal": truth["normal"]})
    assert maps.values["normal"][domain.solvable].tobytes() == truth["normal"][domain.solvable].tobytes()
    assert np.median(np.abs(maps.values["base_color"] - truth["base_color"])[domain.solvable]) < 5e-3


def test_finer_levels_are_shorter_and_begin_at_the_given_estimate():
    schedule = load_schedule("standard").replaced(levels=3, level_iterations=0.5)
    first, *finer = level_schedules(schedule)
    assert first == schedule.replaced(levels=1) and len(finer) == 2
    for level in finer:
        assert level.swarm.start == "given" and level.levels == 1
        assert [s.iterations for s in level.stages] == [round(s.iterations / 2) for s in schedule.stages]
        assert level.prefit.iterations == round(schedule.prefit.iterations / 2)
        assert level.swarm.start_spread < schedule.swarm.start_spread
        assert level.refinement == schedule.refinement and level.fitness == schedule.fitness


def test_levels_and_tiles_are_refused_together():
    domain, _ = subject()
    with pytest.raises(InputError, match="^levels = 2: .* tiles are not solved coarse to fine; set levels = 1"):
        TiledRecovery(
            domain, LAMBERT, PRESETS["swarm"].replaced(levels=2), 1, None, "fragment",
            boxes=[(0, 0, 9, 13), (9, 0, 8, 13)], halo=1,
        )  # fmt: skip
    with pytest.raises(InputError, match="^levels = 2: a Recovery solves one size"):
        Recovery(domain, LAMBERT, PRESETS["swarm"].replaced(levels=2), 1)


def test_a_refusal_of_levels_names_the_limit_that_was_met(monkeypatch):
    coverage, schedule = np.ones((128, 128), bool), PRESETS["swarm"].replaced(levels=2)
    with pytest.raises(InputError, match="does not fit in memory at once, .* allow more with --memory"):
        planning.make_plan(coverage, LAMBERT, schedule, (), 12, memory="device=8M,host=4G")
    monkeypatch.setattr(planning, "max_texture_bytes", lambda free: 1 << 20)
    for device in ("8M", "4G"):  # more memory does not make textures larger
        with pytest.raises(InputError, match=r"exceeds this GPU's textures \(.* 1.0 MiB\), .* fewer photographs"):
            planning.make_plan(coverage, LAMBERT, schedule, (), 12, memory=f"device={device},host=4G")
