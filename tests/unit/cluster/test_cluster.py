"""The pieces of runs over ranks that need no other process: cuts, overlaps, shared samples, devices, agreement."""

import sys
from argparse import Namespace
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from irpso_addon.cluster import agreement as job
from irpso_addon.cluster.partition import around, check_fits, check_gathered, split
from irpso_addon.cluster.samples import RankedStack
from irpso_addon.cluster.transport import CollectiveError, Ranks, joined
from irpso_addon.cluster.worker import Worker
from irpso_addon.core.errors import GpuUnavailableError, InputError
from irpso_addon.geometry.domain import subset, tile
from irpso_addon.geometry.samples import ArrayStack, new_stack
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.engine.halo import overlap_of, place_of
from irpso_addon.solver.planning.cost import recovery_cost
from irpso_addon.solver.planning.memory import Memory
from irpso_addon.solver.planning.plan import Limits
from irpso_addon.solver.settings.schedule import load_schedule
from tests.builders.domains import make_domain

NEED = recovery_cost(load_model("lambert"), load_schedule("swarm"), (), 12)


class FakeRanks(Ranks):
    """A rank without MPI: ``allgather`` returns the values that a test gives for the others."""

    def __init__(self, others, rank=0, size=2):
        super().__init__()
        self._others, self.rank, self.size, self.locals = others, rank, size, size

    def allgather(self, value):
        return [value, *self._others]


@pytest.mark.parametrize("ranks", [1, 2, 3, 7, 64])
def test_boxes_hold_every_covered_texel_once_and_about_as_many_each(ranks):
    rows, columns = np.mgrid[:97, :131]
    coverage = (rows - 40) ** 2 + (columns - 70) ** 2 < 38**2
    found = split(coverage, NEED, ranks)
    count = np.zeros(coverage.shape, int)
    for box in found.boxes:
        x0, y0, width, height = box
        count[y0 : y0 + height, x0 : x0 + width] += 1
    assert (count[coverage] == 1).all() and count.max() == 1
    texels = [tile.texels for tile in found.tiles]
    assert len(texels) == ranks and sum(texels) == coverage.sum()
    assert max(texels) <= 1.5 * coverage.sum() / ranks


def test_ranks_without_texels_have_no_box():
    found = split(np.ones((5, 7), bool), NEED, 4)
    assert found.boxes == ((0, 0, 7, 5), None, None, None)
    with pytest.raises(InputError, match="no texel is covered"):
        split(np.zeros((5, 7), bool), NEED, 4)


def test_a_rank_whose_texels_do_not_fit_its_share_of_the_device_says_so():
    found = split(np.ones((256, 256), bool), NEED, 2)
    size = found.tiles[0].device
    check_fits(found, FakeRanks([]), Memory(2 * size, 1 << 30), Limits(), sharing=2)
    check_fits(found, FakeRanks([]), Memory(size, 1 << 30), Limits(), sharing=1)
    with pytest.raises(InputError, match="start more ranks on more machines"):
        check_fits(found, FakeRanks([]), Memory(2 * size - 2, 1 << 30), Limits(), sharing=2)


def test_a_rank_whose_samples_exceed_one_texture_says_so():
    found = split(np.ones((256, 256), bool), NEED, 2)
    window = 256 * (128 + NEED.stencil_radius)
    memory = Memory(1 << 40, 1 << 40)
    check_fits(found, FakeRanks([]), memory, Limits(), sharing=1)
    with pytest.raises(InputError, match="exceeds this GPU's limits .* start more ranks"):
        check_fits(found, FakeRanks([]), memory, Limits(texture=16 * window * 12 - 1), sharing=1)
    with pytest.raises(InputError, match="255 texels a side"):
        check_fits(found, FakeRanks([]), memory, Limits(side=255), sharing=1)


def test_a_rank_counts_its_window_of_all_photographs_and_the_whole_geometry():
    schedule, sizes = load_schedule("swarm"), {}
    for rounds in (0, 1):
        lit = schedule.replaced(interreflection_rounds=rounds)
        found = split(np.ones((256, 256), bool), recovery_cost(load_model("lambert"), lit, (), 15, held_out=3), 2)
        sizes[rounds] = found.host(found.tiles[1])
    window = 256 * (128 + NEED.stencil_radius)
    assert sizes[1] - sizes[0] == 16 * 15 * window  # a second stack, held-out photographs included
    plain = split(np.ones((256, 256), bool), recovery_cost(load_model("lambert"), schedule, (), 15, held_out=3), 2)
    assert sizes[0] - plain.tiles[1].host == 65 * 256 * 256 + (28 + 16 * 15) * window
    least = 2 * max(map(plain.host, plain.tiles))
    check_fits(plain, FakeRanks([]), Memory(1 << 40, least), Limits(), sharing=1)
    with pytest.raises(InputError, match="of main memory, .* for each of 2 ranks on this machine"):
        check_fits(plain, FakeRanks([]), Memory(1 << 40, least - 2), Limits(), sharing=1)


def test_rank_0_alone_holds_rays():
    lit = recovery_cost(load_model("lambert"), load_schedule("swarm").replaced(interreflection_rounds=1), (), 12)
    plain, found = (split(np.ones((256, 256), bool), each, 4) for each in (NEED, lit))
    more = [tile.device - other.device for tile, other in zip(found.tiles, plain.tiles, strict=True)]
    assert more == [16 * lit.elements * (lit.rays + 1), 0, 0, 0]


def test_a_checkpoint_too_large_for_rank_0_is_refused_before_gathering():
    found = split(np.ones((256, 256), bool), NEED, 2)
    state = 256 * 256 * NEED.kept
    check_gathered(found, Memory(1, state))
    with pytest.raises(InputError, match="--checkpoint-every: a checkpoint takes"):
        check_gathered(found, Memory(1, state - 1))


@pytest.mark.parametrize("halo", [1, 3, 4])
def test_a_published_halo_has_the_width_that_is_read(halo):
    domain = make_domain(13, 17, holes=False)
    boxes = [(0, 0, 7, 5), (7, 0, 10, 5), (0, 5, 5, 8), (5, 5, 12, 8)]
    places = [place_of(box, tile(domain, *box, halo=4)) for box in boxes]
    numbers = np.arange(13 * 17).reshape(13, 17)
    for reader, (x0, y0, width, height) in enumerate(boxes):
        wanted = np.zeros((13, 17), bool)
        wanted[max(0, y0 - halo) : y0 + height + halo, max(0, x0 - halo) : x0 + width + halo] = True
        wanted[y0 : y0 + height, x0 : x0 + width] = False
        heard = set()
        for other, box in enumerate(boxes):
            found = None if other == reader else overlap_of(places[other], places[reader], reader, halo)
            if found is None:
                continue
            theirs = numbers[window(domain, box)][found.here]
            np.testing.assert_array_equal(theirs, numbers[window(domain, boxes[reader])][found.there])
            assert not heard & set(theirs.ravel().tolist())
            heard |= set(theirs.ravel().tolist())
        assert heard == set(numbers[wanted].tolist())


def window(domain, box):
    x0, y0, width, height = around(domain.shape, box, 4)
    return slice(y0, y0 + height), slice(x0, x0 + width)


def test_distributed_samples_read_like_those_in_memory():
    domain = make_domain(6, 5, observations=7, holes=False)
    stacks, asked = [domain.stack], []
    stack = domain.stack

    def ask(order, *arguments):
        asked.append(order)
        if order is Worker.make_second:
            return stacks.append(new_stack(*stack.shape))
        *arguments, second = arguments
        read = stacks[second]
        if order is Worker.layer:
            return read.layer(*arguments).copy()  # ranks bring their parts anew
        if order is Worker.lit:
            return read.subset(*arguments).lit(domain.bake.coverage)
        observations, rows, columns = arguments
        return read.texels(rows, columns)[observations]

    def scatter(order, value):
        observation, layer = value
        assert order is Worker.put
        stacks[1].put(observation, layer)

    shared = RankedStack(SimpleNamespace(ask=ask, scatter=scatter), range(7), (slice(0, 6), slice(0, 5)))
    texels = np.array([0, 5, 2]), np.array([4, 0, 2])
    assert shared.shape == stack.shape
    for _ in range(2):
        np.testing.assert_array_equal(shared.layer(3), stack.layer(3))
    assert asked == [Worker.layer]  # once for both
    np.testing.assert_array_equal(shared.texels(*texels), stack.texels(*texels))
    whole = replace(domain, stack=shared)
    part, wanted = (tile(subset(one, [2, 5]), 1, 2, 3, 4) for one in (whole, domain))
    np.testing.assert_array_equal(np.stack([*part.stack.layers()]), wanted.stack.values)
    np.testing.assert_array_equal(part.stack.lit(part.bake.coverage), wanted.solvable)
    some = np.array([1, 0]), np.array([2, 1])
    np.testing.assert_array_equal(part.stack.texels(*some), wanted.stack.texels(*some))
    fitted = shared.subset(np.array([2, 5]))
    second = fitted.kept(ArrayStack(0.5 * stack.values[[2, 5]]))
    assert second.shape == fitted.shape
    np.testing.assert_array_equal(second.layer(1), 0.5 * stack.layer(5))
    np.testing.assert_array_equal(second.texels(*texels)[1], 0.5 * stack.texels(*texels)[5])
    np.testing.assert_array_equal(second.lit(domain.bake.coverage), stack.subset([5]).lit(domain.bake.coverage))
    np.testing.assert_array_equal(shared.layer(5), stack.layer(5))


@pytest.mark.parametrize(
    ("own", "others", "threads"),
    [({0, 1}, [{0, 1}], 0), ({0}, [{1}], 0), (set(range(8)), [set(range(8, 16))], 8), (set(range(16)), [], 16)],
    ids=["unbound", "bound to a core", "bound to eight", "alone on its machine"],
)
def test_llvmpipe_has_as_many_threads_as_a_rank_has_cores(own, others, threads, monkeypatch):
    monkeypatch.setattr(job, "available_cores", lambda: own)
    monkeypatch.setenv("LP_NUM_THREADS", "")  # so that it is as before afterwards
    monkeypatch.delenv("LP_NUM_THREADS")
    ranks = FakeRanks([])
    ranks._others = [(ranks.host, sorted(cores)) for cores in others] + [("elsewhere", [0, 1, 2, 3])]
    job.choose_device(ranks)
    assert job.os.environ["LP_NUM_THREADS"] == str(threads)
    monkeypatch.setenv("LP_NUM_THREADS", "5")
    job.choose_device(ranks)
    assert job.os.environ["LP_NUM_THREADS"] == "5"


def test_ranks_on_one_machine_take_its_gpus_in_turn(monkeypatch, tmp_path):
    for name in ("pci-0000:41:00.0-render", "pci-0000:01:00.0-render", "pci-0000:01:00.0-card"):
        (tmp_path / name).touch()
    monkeypatch.setattr(job, "_NODES", tmp_path)
    monkeypatch.setenv("LP_NUM_THREADS", "1")
    chosen = []
    for local in range(3):
        monkeypatch.setenv("DRI_PRIME", "")
        monkeypatch.delenv("DRI_PRIME")
        ranks = FakeRanks([], size=3)
        ranks.local = local
        ranks._others = [(ranks.host, "pci-0000_01_00_0"), ("elsewhere", "pci-0000_41_00_0")]
        sharing = job.choose_device(ranks)
        chosen.append((job.os.environ["DRI_PRIME"], sharing))
    assert chosen == [("pci-0000_01_00_0", 2), ("pci-0000_41_00_0", 1), ("pci-0000_01_00_0", 2)]


def test_an_error_of_another_rank_is_raised_here_with_its_name_and_type():
    with pytest.raises(CollectiveError) as raised:
        FakeRanks([(GpuUnavailableError, "no GPU context", "rank 1 on node7")]).agreed(lambda: 3)
    assert isinstance(raised.value.error, GpuUnavailableError) and raised.value.error.exit_code == 3
    assert str(raised.value.error) == "rank 1 on node7: no GPU context"
    assert FakeRanks([None]).agreed(lambda: 3) == 3


def test_an_error_on_all_ranks_is_reported_like_one_process():
    def fail():
        raise InputError("capture.toml: no such file")

    with pytest.raises(CollectiveError) as raised:
        FakeRanks([(InputError, "capture.toml: no such file", "rank 1 on node7")]).agreed(fail)
    assert str(raised.value.error) == "capture.toml: no such file"


@pytest.mark.parametrize("name", ["OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "SLURM_STEP_NUM_TASKS"])
def test_ranks_without_mpi4py_are_refused(name, monkeypatch):
    monkeypatch.setitem(sys.modules, "mpi4py", None)
    monkeypatch.setenv(name, "1")
    assert joined() is None
    monkeypatch.setenv(name, "4")
    with pytest.raises(InputError, match="4 processes were started together, but Python's mpi4py does not load"):
        joined()


def test_ranks_with_another_capture_or_options_are_named(monkeypatch):
    about = {"program": ("version 1", "a"), "options": ("9 of them", "x")}
    monkeypatch.setattr(job, "_about", lambda options, capture: about)
    for other, words in (({**about, "options": ("9 of them", "y")}, "options of rank 1"), (about, "")):
        ranks = FakeRanks([("rank 1 on b", other)])
        monkeypatch.setattr(ranks, "agreed", lambda work: work())
        if words:
            with pytest.raises(InputError, match=words):
                job.check_alike(ranks, Namespace(), None)
        else:
            job.check_alike(ranks, Namespace(), None)


def test_sent_messages_are_counted(monkeypatch):
    monkeypatch.setattr("irpso_addon.cluster.transport._MAX_BYTES", 40)
    here = SimpleNamespace(Get_rank=lambda: 0, Get_size=lambda: 3)
    sent = []
    world = SimpleNamespace(
        **vars(here), Split_type=lambda kind: here, Irecv=lambda part, source, tag: None,
        Isend=lambda part, dest, tag: sent.append((dest, bytes(part))),
    )  # fmt: skip
    mpi = SimpleNamespace(COMM_TYPE_SHARED=0, Request=SimpleNamespace(Waitall=lambda requests: None))
    ranks = Ranks(mpi, world)
    sent_arrays = {1: np.arange(25, dtype=np.float32), 2: np.zeros((2, 3), np.float32)}
    assert ranks.exchanged(sent_arrays, {1: (4, 2)})[1].shape == (4, 2)
    ranks.exchanged({1: np.zeros(1, np.float32)}, {})
    assert [(rank, len(part)) for rank, part in sent] == [(1, 40), (1, 40), (1, 20), (2, 24), (1, 4)]
    assert b"".join(part for rank, part in sent[:3]) == sent_arrays[1].tobytes() and ranks.sent == (5, 128)
