"""Plans of tiles and memory: against bytes counted by hand, and by what must hold whatever the domain."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.errors import InputError
from irpso_addon.geometry.samples import mapped_array, new_stack, place_of
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.planning import memory
from irpso_addon.solver.planning.cost import recovery_cost
from irpso_addon.solver.planning.memory import Memory, amount, free_memory, machine_memory, parse_memory
from irpso_addon.solver.planning.plan import Limits, device_bytes, max_texture_bytes, plan_recovery
from irpso_addon.solver.settings.schedule import load_schedule

G, M = 1 << 30, 1 << 20
PLENTY = Memory(1 << 50, 1 << 50)
SWARM = load_schedule("swarm").replaced(particles=9, particles_per_dimension=0.0, iterations=60, c3_fade=0.25)


def cost_of(observations=100, **options):
    return recovery_cost(load_model("lambert"), SWARM, (), observations, **options)


def disc(size, radius):
    y, x = np.mgrid[:size, :size] - size / 2 + 0.5
    return y**2 + x**2 < radius**2


# ---- what is asked for ---------------------------------------------------------------------------------------------


def test_the_bytes_of_a_texel_match_a_count_by_hand():
    # lambert: 6 components in two RGBA textures; base colour 3 + normal on the hemisphere 2 = 5 dimensions, two blocks.
    cost = cost_of(100)
    stack, geometry = 100 * 16, 4 * 16
    estimates, deviations, residual = 2 * 2 * 16, 2 * 16, 16
    atlas = 20 * (16 + 16 + 16 + 4)  # 9 particles · 2 blocks in an atlas of 5 × 4 tiles
    bests, candidates = 2 * 16 + 4, 4 * 16 + 16
    texel = stack + geometry + estimates + deviations + residual + atlas + bests + candidates
    # 256 covered texels lie in 16 × 16 places; the rectangle of 400 has 8 bytes each, the table of lights 48 a light.
    assert device_bytes(256, 400, cost) == 256 * texel + 400 * 8 + 100 * 48
    assert cost.kept == atlas + bests + 2 * 16
    # 257 texels need a grid of 17 × 16.
    assert device_bytes(257, 400, cost) == 272 * texel + 400 * 8 + 100 * 48


def test_evaluations_and_exchanges_are_counted_over_all_iterations():
    cost = cost_of()
    # The neighbour term of 60 iterations lasts 15 of them (0 … 14); neighbours are tried at 9, 19, 29, 39, 49, 59.
    assert (cost.stencil_radius, cost.exchanges, cost.evaluations) == (1, 15 + 5, 9 + 60)
    wide = recovery_cost(load_model("lambert"), SWARM.replaced(neighbourhood=7, c3_fade=0.0), (), 100)
    assert (wide.stencil_radius, wide.exchanges) == (3, 60)
    alone = recovery_cost(load_model("lambert"), SWARM.replaced(c3=0.0, neighbour_interval=0), (), 100)
    assert (alone.stencil_radius, alone.exchanges) == (0, 0)
    rounds = recovery_cost(load_model("lambert"), SWARM.replaced(interreflection_rounds=2), (), 100)
    assert rounds.evaluations == 3 * (9 + 60)


def test_the_work_of_levels_is_that_of_ever_smaller_maps():
    work = {n: recovery_cost(load_model("lambert"), SWARM.replaced(levels=n), (), 100).work for n in (1, 3)}
    # Nine particles are placed and searched for 60 iterations; finer levels have 0.4 of these.
    assert work[3] / work[1] == pytest.approx((69 / 16 + 33 / 4 + 33) / 69)


# ---- tiles ---------------------------------------------------------------------------------------------------------


def test_a_fitting_domain_is_one_tile():
    plan = plan_recovery(disc(64, 30), cost_of(), PLENTY)
    assert (plan.boxes, plan.halo, plan.resident, plan.passes) == ([(0, 0, 64, 64)], 0, True, 1)
    assert (plan.stack_on, plan.state_on, plan.scratch) == ("memory", "memory", 0)
    assert plan.device == device_bytes(int(disc(64, 30).sum()), 64 * 64, cost_of())
    assert plan.evaluations == 69 * disc(64, 30).sum()


@pytest.mark.parametrize("covered", [disc(96, 40), np.random.default_rng(1).random((70, 50)) < 0.3, np.eye(80) > 0])
@pytest.mark.parametrize("device", [6 * M, 2 * M, M // 2])
def test_tiles_hold_every_covered_texel_once_and_fit(covered, device):
    cost = cost_of(20)
    plan = plan_recovery(covered, cost, Memory(device, G))
    count = np.zeros(covered.shape, int)
    for x0, y0, width, height in plan.boxes:
        count[y0 : y0 + height, x0 : x0 + width] += 1
        part = covered[max(0, y0 - 1) : y0 + height + 1, max(0, x0 - 1) : x0 + width + 1]
        assert device_bytes(int(part.sum()), part.size, cost) <= device
    assert (count[covered] == 1).all() and count.max() <= 1
    assert plan.device <= device
    assert sum(tile.texels for tile in plan.tiles) == plan.texels == covered.sum()


def test_tiles_are_about_even_and_hardly_more_than_are_needed():
    covered, cost = disc(512, 250), cost_of()
    plan = plan_recovery(covered, cost, Memory(64 * M, 64 * G))
    texels = [tile.texels for tile in plan.tiles]
    assert max(texels) <= 1.05 * min(texels)
    # What a tile that comes back has taken along lies on the device twice for a moment.
    together = device_bytes(int(covered.sum()), covered.size, cost) + cost.kept * covered.sum()
    assert len(texels) <= 1.15 * together / (64 * M) + 1
    restored = max(tile.restored for tile in plan.tiles)
    assert plan.device == max(tile.device for tile in plan.tiles) + restored <= 64 * M
    assert plan.halo == 1 and not plan.resident and plan.passes == 1 + cost.exchanges


def test_a_texture_that_is_too_large_makes_tiles_that_stay_on_the_device():
    covered, cost = np.ones((100, 100), bool), cost_of()
    plan = plan_recovery(covered, cost, PLENTY, Limits(texture=100 * 100 * 16 * 100 // 3))
    assert len(plan.boxes) == 4 and plan.resident and plan.passes == 1
    assert all(tile.texels + 4 * 51 <= 100 * 100 / 3 + 204 for tile in plan.tiles)
    # An atlas of 18 tiles lies 5 × 4: the side of a texture allows a fifth of it for each.
    narrow = plan_recovery(covered, cost, PLENTY, Limits(side=300))
    assert all(5 * np.ceil(np.sqrt(tile.texels)) <= 300 for tile in narrow.tiles) and len(narrow.tiles) >= 3


def test_a_full_oblong_card_is_cut_where_its_own_particles_exceed_a_texture():
    # A grid of its texels would be square; a full card keeps its shape, beside which fewer tiles of particles fit.
    cost, limits = cost_of(8), Limits(side=16384, texture=1 << 40)
    tiles = max(phase.atlas for phase in cost.phases)
    card = np.ones((1200, 8400), bool)
    assert (16384 // 8400) * (16384 // 1200) < tiles <= (16384 // 3175) ** 2
    assert len(plan_recovery(card, cost, PLENTY, limits).tiles) > 1
    card[0, 0] = False
    assert len(plan_recovery(card, cost, PLENTY, limits).tiles) == 1


def test_a_single_tile_smaller_than_the_domain_has_a_halo():
    covered = np.zeros((200, 200), bool)
    covered[10:40, 20:50] = True
    cost = cost_of()
    plan = plan_recovery(covered, cost, PLENTY, Limits(side=190))
    assert [tuple(box) for box in plan.boxes] == [(20, 10, 30, 30)]
    assert plan.halo == cost.stencil_radius > 0


def test_more_observations_than_a_texture_has_layers_are_refused():
    with pytest.raises(InputError, match="2049 observations exceed this GPU's textures of 2048 layers; hold some out"):
        plan_recovery(disc(8, 4), cost_of(2049), PLENTY)


def test_a_device_that_is_too_small_for_the_smallest_tile_is_named_with_the_remedy():
    message = r"--memory device=.* KiB \(--memory\): a tile of . × . texels .* at least (.*) KiB .*; allow more"
    allowed, refusals = 50.0, 0
    while True:  # who allows what is needed is not refused for ever
        try:
            plan_recovery(disc(64, 30), cost_of(), Memory(int(1024 * allowed), G))
            break
        except InputError as refused:
            needed = float(re.search(message, str(refused))[1])
        assert needed > allowed
        allowed, refusals = 1.01 * needed, refusals + 1
    assert refusals


def test_a_host_that_is_too_small_is_named_with_the_remedy():
    with pytest.raises(InputError, match=r"--memory host=100 MiB .* needs .* even with the images in a scratch file"):
        plan_recovery(disc(64, 30), cost_of(), Memory(G, 100 * M))


def test_a_domain_without_a_covered_texel_is_refused():
    with pytest.raises(InputError, match="no texel is covered"):
        plan_recovery(np.zeros((4, 4), bool), cost_of(), PLENTY)


# ---- memory and scratch --------------------------------------------------------------------------------------------


def test_the_sample_stack_leaves_the_memory_first_then_the_state_of_waiting_tiles():
    covered, cost = disc(1024, 500), cost_of()
    stack = 1024 * 1024 * 100 * 16
    plans = [plan_recovery(covered, cost, Memory(256 * M, host)) for host in (8 * G, 3 * G, 5 * G // 4)]
    assert [(p.stack_on, p.state_on) for p in plans] == [("memory", "memory"), ("scratch", "memory"), ("scratch",) * 2]
    assert [p.scratch for p in plans[:2]] == [0, stack]
    assert plans[0].host - plans[1].host == stack
    state = plans[2].scratch - stack
    assert cost.kept * covered.sum() <= state <= 1.01 * cost.kept * covered.sum()
    assert all(plan.host <= plan.memory.host for plan in plans)


def test_observations_held_out_lie_in_the_stack_but_not_on_the_device():
    plain, held = (plan_recovery(disc(64, 30), cost_of(100, held_out=n), PLENTY) for n in (0, 10))
    assert plain.host - held.host == pytest.approx(disc(64, 30).sum() * 10 * 16, rel=0.02)  # the tile's copy alone
    assert plain.device > held.device
    assert (plain.observations, held.observations) == (100, 90)


def test_rounds_of_interreflection_hold_their_light_their_maps_and_their_rays():
    covered = disc(64, 30)
    light = {"interreflection_resolution": 16, "interreflection_rays": 16}
    plans = {}
    for rounds in (0, 1, 3):
        schedule = SWARM.replaced(interreflection_rounds=rounds, **light)
        plans[rounds] = plan_recovery(covered, recovery_cost(load_model("lambert"), schedule, (), 100), PLENTY)
    elements = np.count_nonzero(covered)  # a cell may have several; there are no more than 8192, or than texels
    assert plans[1].device - plans[0].device == plans[3].device - plans[0].device == (16 + 1) * elements * 16
    maps = 64 * 64 * (6 + 1) * 4  # lambert's six components, and whether they explain the photographs
    # Number, elements, weights and albedo of a texel are 48 bytes, directions and elements of a ray 16.
    light = 64 * 64 * 48 + elements * 100 * 3 * 4
    assert plans[3].host - plans[1].host == 2 * (maps + light)
    # While light is exchanged no tile moves: the larger of both counts, here that of the tile.
    assert plans[1].host - plans[0].host == maps + light
    many = SWARM.replaced(interreflection_rounds=1, interreflection_resolution=64, interreflection_rays=1024)
    plan = plan_recovery(covered, recovery_cost(load_model("lambert"), many, (), 100), PLENTY)
    assert plan.host - plans[1].host > 16 * elements * 1024 - plans[1].tiles[0].host
    assert plans[1].host - plans[0].host < 64 * 64 * 100 * 16  # less than a second stack


def test_the_triangles_at_which_rays_are_cast_need_memory():
    model, schedule = load_model("lambert"), SWARM.replaced(interreflection_rounds=1)
    few, many, none = (
        recovery_cost(model, schedule.replaced(interreflection_rounds=rounds), (), 10, triangles=triangles)
        for rounds, triangles in ((1, 10**7), (1, 2 * 10**7), (0, 2 * 10**7))
    )
    covered = disc(64, 30)
    hosts = [plan_recovery(covered, cost, PLENTY).host for cost in (few, many, none)]
    assert hosts[1] - hosts[0] > 4 * 10**9  # a tree of a million triangles takes 0.45 GiB
    assert hosts[2] < 10**9
    with pytest.raises(InputError, match=r"or recover without interreflection \(interreflection_rounds=0"):
        plan_recovery(covered, many, replace(PLENTY, host=2 << 30))


def test_no_more_rays_are_counted_than_texels_have():
    light = {"interreflection_rounds": 1, "interreflection_resolution": 1024, "interreflection_rays": 1024}
    cost = recovery_cost(load_model("lambert"), SWARM.replaced(**light), (), 10)
    plan = plan_recovery(np.ones((8, 16), bool), cost, PLENTY)
    assert plan.device == device_bytes(128, 128, cost_of(10)) + 128 * 1025 * 16
    with pytest.raises(InputError, match="65536 elements of 1024 rays exceed .* lower interreflection_resolution"):
        plan_recovery(np.ones((256, 256), bool), cost, PLENTY, Limits(texture=(1 << 30) - 1))


def test_the_elements_of_every_udim_tile_are_counted():
    lit = SWARM.replaced(interreflection_rounds=1, interreflection_resolution=256, interreflection_rays=16)
    covered = np.ones((512, 1024), bool)
    one, two = (
        plan_recovery(covered, recovery_cost(load_model("lambert"), lit, (), 10, tiles=tiles), PLENTY)
        for tiles in (1, 2)
    )
    assert two.device - one.device == 256**2 * (16 + 1) * 16


def test_levels_hold_the_samples_of_every_coarse_map():
    plans = {
        n: plan_recovery(
            disc(64, 30),
            recovery_cost(load_model("lambert"), SWARM.replaced(levels=n), (), 100, held_out=10),
            PLENTY,
            stack_on="scratch",
        )
        for n in (1, 3)
    }
    assert plans[3].scratch - plans[1].scratch == 16 * 90 * (32 * 32 + 16 * 16)
    assert plans[3].host == plans[1].host


def test_an_existing_stack_stays_where_it_is():
    assert plan_recovery(disc(64, 30), cost_of(), PLENTY, stack_on="scratch").stack_on == "scratch"


def test_a_plan_names_what_it_needs_with_the_samples_that_are_in_memory():
    mask, cost = disc(512, 250), cost_of()
    needed = plan_recovery(mask, cost, Memory(64 * G, 64 * G), stack_on="memory").host
    plan_recovery(mask, cost, Memory(64 * G, needed), stack_on="memory")
    with pytest.raises(InputError, match=f"needs {re.escape(amount(needed))}; allow more"):
        plan_recovery(mask, cost, Memory(64 * G, needed - 1), stack_on="memory")
    with pytest.raises(InputError, match="even with the images in a scratch file"):
        plan_recovery(mask, cost, Memory(64 * G, M))


def test_the_place_of_samples_is_known(tmp_path):
    assert [place_of(new_stack(2, 3, 4, folder)) for folder in (None, tmp_path)] == ["memory", "scratch"]


def test_a_plan_is_plain_data_and_lines_for_people():
    plan = plan_recovery(disc(512, 250), cost_of(), Memory(64 * M, 64 * G))
    assert json.loads(json.dumps(plan.as_dict()))["texels"] == plan.texels
    text = "\n".join(plan.lines())
    for word in ("512 × 512", "100 observations", "halo", "64.0 MiB", "64.0 GiB", "scratch file  none", "evaluations"):
        assert word in text


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("4G", {"device": 4 * G, "host": 4 * G}),
        ("512m", {"device": 512 * M, "host": 512 * M}),
        ("1.5GiB", {"device": 3 * G // 2, "host": 3 * G // 2}),
        ("device=4G,host=8G", {"device": 4 * G, "host": 8 * G}),
        ("host = 100 KB", {"host": 102400}),
        ("DEVICE=2T", {"device": 2048 * G}),
        ("1000000", {"device": 1000000, "host": 1000000}),
    ],
)
def test_amounts_of_memory_are_read(text, wanted):
    assert parse_memory(text) == wanted


@pytest.mark.parametrize(
    "text",
    ["", "x", "0", "-4G", "4Q", "gpu=4G", "device=", "4G,4G", "device=1G,device=2G", "1G,", "0.1", "9" * 400 + "G"],
)
def test_an_invalid_amount_of_memory_is_refused(text):
    with pytest.raises(InputError, match="^--memory .*: write an amount, as in 4G, or device=4G,host=8G"):
        parse_memory(text)


def test_amounts_are_formatted_readably():
    assert [amount(n) for n in (5, 2048, 3 * M, 1000 * M, 3 * G // 2, 27 * G)] == [
        "5 B", "2.0 KiB", "3.0 MiB", "1000 MiB", "1.5 GiB", "27.0 GiB"]  # fmt: skip


def test_unset_budgets_come_from_the_machine(monkeypatch):
    monkeypatch.setattr(memory, "free_memory", lambda: 10 * G)
    real = machine_memory("host=2G", "NVIDIA H200")
    assert (real.host, real.device) == (2 * G, 4 * G) and "assumed" in real.device_from
    assert machine_memory(None, "NVIDIA H200").host == 8 * G
    told = machine_memory(None, "NVIDIA H200", 100 * G)
    assert told.device == 80 * G and "the device's free memory" in told.device_from
    little = machine_memory(None, "inside a processor", G // 2)
    assert little.device == 4 * G and "reports 512 MiB free" in little.device_from
    software = machine_memory(None, "llvmpipe (LLVM 15)")  # its textures are the host's memory too
    assert (software.host, software.device) == (4 * G, 4 * G)
    assert machine_memory("3G", "llvmpipe") == Memory(3 * G, 3 * G)
    assert machine_memory(None, "NVIDIA H200", held=5 * G).host == 12 * G  # samples that are read and planned again


def test_a_texture_may_be_large_where_the_memory_is():
    assert [max_texture_bytes(free) for free in (None, G, 4 * G, 16 * G)] == [G, G, G, 2 * G]
    assert 7 * G < max_texture_bytes(200 * G) < 8 * G


def test_free_memory_comes_from_the_system():
    with open("/proc/meminfo") as file:
        available = next(int(line.split()[1]) for line in file if line.startswith("MemAvailable"))
    assert free_memory() == pytest.approx(available * 1024, rel=0.2)


def test_an_array_in_a_scratch_file_leaves_no_name_behind_and_is_zero(tmp_path):
    array = mapped_array(tmp_path, (3, 5, 4))
    assert not array.any() and array.dtype == np.float32 and array.shape == (3, 5, 4)
    array[1] = 7
    assert (array[1] == 7).all() and array.sum() == 140
    assert not list(tmp_path.iterdir())


def test_a_disk_without_room_for_a_scratch_file_is_refused_before_anything_is_written(tmp_path):
    with pytest.raises(InputError, match="holds no scratch file of .* set TMPDIR to a folder with room"):
        mapped_array(tmp_path, (1 << 20, 1 << 20, 4))
    assert not list(tmp_path.iterdir())
