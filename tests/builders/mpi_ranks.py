"""Recovers synthetic subjects over several ranks and in one process; a test starts it under mpirun.

Usage: mpirun -n 5 python tests/builders/mpi_ranks.py OUT. Rank 0 writes all digests into OUT/digests.json.
"""

import hashlib
import json
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from irpso_addon.blender.ray_caster import ray_caster_steps
from irpso_addon.cluster.partition import Partition, around
from irpso_addon.cluster.recovery import Leader, RankedRecovery, serve
from irpso_addon.cluster.transport import joined
from irpso_addon.cluster.worker import Worker
from irpso_addon.geometry.domain import tile
from irpso_addon.geometry.light.interreflection_geometry import CardInterreflection, MeshInterreflection
from irpso_addon.geometry.samples import ArrayStack
from irpso_addon.gpu import context
from irpso_addon.gpu.program import ProgramCache
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.engine.recovery import Recovery
from irpso_addon.solver.interreflection.rounds import InterreflectionRounds
from irpso_addon.solver.planning.cost import recovery_cost
from irpso_addon.solver.planning.plan import divided
from irpso_addon.solver.settings.refinement_groups import Refinement
from irpso_addon.solver.settings.schedule import load_schedule
from tests.builders.cavity import cap_card, cavity_mesh, half_cavity
from tests.builders.command_line import dome_lights
from tests.builders.domains import SHORT, masked, subject

PLAN = {  # case → numbers of ranks, and the iteration of the checkpoint that other numbers of ranks resume
    "prime sizes, near lights, a window of 9": ((1, 2, 4, 5), None),
    "prefit, refinement and prior": ((2,), 11),
    "a threshold": ((2,), None),
    "seams of a mesh": ((4,), 4),
    "fewer texels than ranks want": ((5,), None),
    "rounds of interreflection": ((2,), 17),  # the last of three recoveries
    "rounds on a card": ((2,), None),
    "indirect light separated by its colour": ((4,), 9),  # after the separation, before the second prefit
}
LAMBERT, TWO_LOBES = load_model("lambert"), load_model("cook_torrance_two_lobe")
WIDE = SHORT.replaced(neighbourhood=9, c3_fade=0.0, neighbour_interval=3, start="lambert")
STANDARD = load_schedule("standard").replaced(
    iterations=3, prefit_iterations=2, prior_rounds=2, prior_scales=2, prior_iterations=2, neighbour_interval=2,
    refinement=Refinement(iterations=2, start_iterations=1, race_iterations=1, rounds=1, round_iterations=1),
)  # fmt: skip
ROUNDS = STANDARD.replaced(materials_rounds=1, materials_iterations=2, interreflection_rounds=2)
THRESHOLD = SHORT.replaced(iterations=400, loss="l1", threshold=0.06, c3=0.0, neighbour_interval=30)


def cases():
    """Return name → (domain, model, schedule), and the geometry of the last."""
    from tests.gpu.geometry.test_seams import observed, sheet
    from tests.gpu.solver import test_indirect_colour as colour

    near, _ = subject(23, 19, near=True, perspective=True, colored=True, observations=9)
    rows, columns = np.indices(near.shape)
    near = masked(near, (rows >= 9) | (columns >= 6))  # some boxes are ragged
    glossy, _ = subject(13, 17, model="cook_torrance_two_lobe", observations=12, near=True)
    level, _ = subject(19, 11, holes=False)
    seams = observed(sheet("mirrored and turned"), holes=0.1)
    mesh = cavity_mesh(opening=0.0)
    hollow = half_cavity(mesh, (0.8, 0.5, 0.3), dome_lights(10, 50.0) * (1, 1, -1), shape=(11, 37))
    cap, camera, _ = cap_card((0.8, 0.6, 0.4), dome_lights(10, 50.0), side=19)
    return {
        "prime sizes, near lights, a window of 9": (near, LAMBERT, WIDE),
        "prefit, refinement and prior": (glossy, TWO_LOBES, STANDARD),
        "a threshold": (level, LAMBERT, THRESHOLD),
        "seams of a mesh": (seams, LAMBERT, SHORT.replaced(neighbour_interval=2, neighbourhood=5)),
        "fewer texels than ranks want": (subject(5, 7)[0], LAMBERT, SHORT),
        "rounds of interreflection": (
            hollow,
            load_model("metallic_roughness"),
            ROUNDS,
            MeshInterreflection(mesh, ray_caster_steps, 24, 16),
        ),
        "rounds on a card": (cap, LAMBERT, ROUNDS, CardInterreflection(camera, "normal", ray_caster_steps, 19, 16)),
        "indirect light separated by its colour": (colour.corner()[0], LAMBERT, colour.SHORT),
    }


def digest(maps, progress):
    """Return a hash of maps and progress."""
    sha256 = hashlib.sha256(repr(progress).encode())
    arrays = {**maps.values, "residual": maps.residual, "covered": maps.solved}
    for array in [*arrays.values(), *(maps.confidence or {}).values(), *(maps.alternatives or {}).values()]:
        sha256.update(np.ascontiguousarray(array).tobytes())
    return sha256.hexdigest()


def worker_of(ranks, case):
    """Return this rank's worker, whose window is cut from the complete domain."""
    domain, model, schedule, *_ = case
    halo = recovery_cost(model, schedule, (), domain.observations).stencil_radius
    height, width = domain.shape
    boxes = list(divided(domain.bake.coverage, (0, 0, width, height), ranks.size))
    boxes += [None] * (ranks.size - len(boxes))
    box = boxes[ranks.rank]
    window = None if box is None else tile(replace(domain, seams=None), *around(domain.shape, box, halo))
    whole = replace(domain, stack=ArrayStack(np.zeros((domain.observations, 0, 0, 4), np.float32)))
    return Worker(ranks, Partition(whole, tuple(boxes), halo, window), {})


def over(ranks, case, work):
    """Return the result of ``work`` on a recovery over ranks; None on all ranks but the first."""
    worker = worker_of(ranks, case)
    if not ranks.leads:
        return serve(worker) and None
    leader = Leader(worker)
    with recovery_of((leader.domain, *case[1:]), partial(RankedRecovery, leader)) as recovery:
        result = work(recovery)
    leader.end()
    return result


def whole(case, work):
    """Return the result of ``work`` on a recovery in one process."""
    with recovery_of(case, Recovery) as recovery:
        return work(recovery)


def recovery_of(case, solve):
    """Return the recovery of a case. solve: makes one without rounds of interreflection."""
    domain, model, schedule, *geometry = case
    settings = domain, model, schedule, 1, {}, "fragment"
    return InterreflectionRounds(*settings, *geometry, solve=solve) if geometry else solve(*settings)


def to_the_end(recovery):
    """Recover to the end, with one read of the maps on the way; return the digest."""
    recovery.step(iterations=5)
    recovery.maps(confidence=False)
    recovery.step()
    return digest(recovery.maps(), recovery.progress)


def saved(path, iterations):
    """Return a function that runs ``iterations`` iterations and writes a checkpoint."""

    def work(recovery):
        recovery.step(iterations=iterations)
        recovery.save(path, {"mark": np.arange(3)})

    return work


def resumed(path):
    """Return a function that resumes from a checkpoint to the end."""

    def work(recovery):
        recovery.step(iterations=1)
        assert recovery.load(path)["mark"].tolist() == [0, 1, 2]
        recovery.step()
        return digest(recovery.maps(), recovery.progress)

    return work


def main(folder):
    """Recover all cases over their numbers of ranks, some with a change of it midway; write the digests."""
    world = joined()
    programs = ProgramCache()  # cases share kernels
    context.ensure()
    # Created once: a rank outside a case goes on to its next case and waits there.
    groups = {size: world.among(world.rank < size) for size in (1, 2, 4, 5)}
    digests = {}

    def some(size, case, work):
        return None if groups[size] is None else over(groups[size], case, work)

    for name, case in cases().items():
        sizes, stop = PLAN[name]
        by_size = {"one process": whole(case, to_the_end)} if world.leads else {}
        for size in sizes:
            by_size[f"{size} ranks"] = some(size, case, to_the_end)
        if stop is not None:
            path = folder / name
            some(4, case, saved(path, stop))
            by_size["4 ranks, then 5"] = some(5, case, resumed(path))
            if world.leads:
                by_size["4 ranks, then one process"] = whole(case, resumed(path))
                whole(case, saved(path, stop))
            by_size["one process, then 2 ranks"] = some(2, case, resumed(path))
        digests[name] = by_size
    if world.leads:
        (folder / "digests.json").write_text(json.dumps(digests, indent=2))
    programs.close()
    world.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
    context.exit_process(0)
