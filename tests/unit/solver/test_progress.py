"""The fraction and the time left of a recovery: a model of the work, and a fake clock."""

import pytest

from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.engine.progress import Course, Progress, TimeLeft
from irpso_addon.solver.planning.cost import work_of
from irpso_addon.solver.settings.resolve import ResolvedPrefit, ResolvedSwarm, particle_count, resolve
from irpso_addon.solver.settings.schedule import load_schedule


def works(preset, observations=24, model="principled"):
    schedule, model = load_schedule(preset), load_model(model)
    stages = resolve(schedule, model, set(), observations)
    return stages, [work_of(stage, model, schedule, observations) for stage in stages]


def at(fraction, stage=0, end=1.0):
    return Progress(stage, 2, "", 0, 1, 0, 1, fraction, end, 0, fraction >= 1)


@pytest.mark.parametrize("preset", ["standard", "swarm", "paper", "constriction"])
def test_every_iteration_is_counted_and_so_is_every_placing(preset):
    for stage, work in zip(*works(preset), strict=True):
        placings = len(work) - stage.iterations
        assert min(work) > 0 and (placings > 0) == isinstance(stage, ResolvedSwarm | ResolvedPrefit)


def test_placing_counts_as_many_renders_as_there_are_particles():
    (stage,), (work,) = works("swarm", observations=10)
    schedule = load_schedule("swarm")
    particles = particle_count(schedule, stage.dimensions(schedule.swarm.normal))
    assert particles > 1 and work == (10.0,) * (particles + stage.iterations)
    prefit, swarm = (works("standard")[1][i] for i in (0, 5))
    assert swarm[0] == swarm[1] and prefit[0] == prefit[1]  # all are placed at once, and all are moved


@pytest.mark.parametrize("observations", [10, 24, 37, 50, 96])
def test_the_fraction_never_steps_back(observations):
    stages, work = works("standard", observations)
    course = Course(stages, work)
    fractions = [
        course.at(index, iteration, part, 0).fraction
        for index, stage in enumerate(stages)
        for iteration in range(stage.iterations)
        for part in (0.0, 0.5, 1.0)
    ]
    fractions.append(course.at(len(stages), None, 0.0, 0).fraction)
    assert fractions == sorted(fractions) and fractions[-1] == 1


def test_the_time_left_is_the_rest_of_the_work_at_the_pace_so_far():
    left = TimeLeft()
    assert left.after(5.0, at(0.0)) is None  # what it took before it began does not count
    for fraction in (0.1, 0.25, 0.5, 0.9):
        assert left.after(5.0 + 200 * fraction, at(fraction)) == pytest.approx(200 * (1 - fraction))
    assert left.after(205.0, at(1.0)) == 0


def test_a_slower_stage_keeps_its_own_pace():
    left = TimeLeft()
    left.after(0.0, at(0.0, 0, 0.5))
    left.after(50.0, at(0.5, 1, 1.0))  # 100 s for all the work so far, three times as much from here on
    assert left.after(50.0 + 300 * 0.1, at(0.6, 1, 1.0)) == pytest.approx(300 * 0.4)


def test_a_resumed_run_is_timed_from_its_resume():
    left = TimeLeft()
    left.after(0.0, at(0.6))
    assert left.after(10.0, at(0.8)) == pytest.approx(10.0)


def test_a_run_that_has_hardly_begun_has_no_estimate():
    left = TimeLeft()
    left.after(0.0, at(0.0))
    assert left.after(1.0, at(0.001)) is None
