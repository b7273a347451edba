"""Random numbers: the GPU's are the oracle's bit for bit, and the oracle's are random; so are the choices made."""

from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from irpso_addon.gpu import context, textures
from irpso_addon.gpu.bands import Bands
from irpso_addon.gpu.kernel import Kernel, Output
from irpso_addon.gpu.passes import Pass
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.kernels.single_passes import copy_pass
from irpso_addon.solver.phases.phase import PhaseContext
from irpso_addon.solver.phases.sequential_swarm import SequentialSwarmPhase
from irpso_addon.solver.settings.resolve import resolve
from irpso_addon.solver.settings.schedule import load_schedule
from irpso_addon.solver.state.packing import Packing
from irpso_addon.solver.state.textures import DomainTextures, Estimates
from tests.builders.domains import make_domain
from tests.oracles import random_numbers as swarm_numbers
from tests.oracles import swarm as oracle

# The numbers are fixed, so a test that passes once passes always; this is how unlikely a chance we would still believe.
BELIEVABLE = 1e-4
KERNEL = Path(__file__).parents[1] / "kernels" / "random_numbers.glsl"
CONSTANTS = ("u_seed", "u_iteration", "u_origin_x", "u_origin_y", "u_particle", "u_purpose")


@pytest.fixture(scope="module", params=["fragment", "compute"])
def gpu_numbers(request):
    """A function of the constants that returns the floats and the two hashed words of 19×11 texels."""
    context.ensure()
    outputs = (Output("o_uniform"), Output("o_halves"))
    work = Pass(Kernel(KERNEL, outputs, {}, dict.fromkeys(CONSTANTS, "INT"), {}), request.param)
    copy = copy_pass()

    def run(**constants):
        targets = [textures.empty(19, 11), textures.empty(19, 11)]
        work.run(targets, {}, constants)
        results = []
        for target in targets:
            results.append(textures.empty(19, 11))
            copy.run(results[-1:], {"u_source": target})
        return [textures.download(t) for t in results]

    yield run
    work.close()
    copy.close()


@pytest.mark.parametrize(
    "key",
    [(0, 0, 0, 0, 0, 0), (1, -16, 0, 0, 15, 7), (2**31 - 1, 999_999, 4095, 16383, 1023, 4), (-5, 3, 300, 70, 2, 1)],
)
def test_the_gpu_draws_the_numbers_of_the_oracle_bit_for_bit(gpu_numbers, key):
    constants = dict(zip(CONSTANTS, key, strict=True))
    uniform, halves = gpu_numbers(**constants)
    y, x = np.mgrid[:11, :19]
    bits = swarm_numbers.random_bits(key[0], key[1], x + key[2], y + key[3], key[4], key[5])
    np.testing.assert_array_equal(
        uniform, swarm_numbers.random_uniform(key[0], key[1], x + key[2], y + key[3], key[4], key[5])
    )
    words = halves.astype(np.uint32)
    np.testing.assert_array_equal(words[..., 0] << 16 | words[..., 1], bits[..., 0])
    np.testing.assert_array_equal(words[..., 2] << 16 | words[..., 3], bits[..., 3])


def test_pcg4d_is_the_published_hash():
    # Evaluated with integers of unlimited size, step by step as in Jarzynski & Olano 2020, listing of pcg4d.
    def reference(v):
        v = [(c * 1664525 + 1013904223) % 2**32 for c in v]
        for last in (False, True):
            if last:
                v = [c ^ (c >> 16) for c in v]
            for a, b, c in ((0, 1, 3), (1, 2, 0), (2, 0, 1), (3, 1, 2)):
                v[a] = (v[a] + v[b] * v[c]) % 2**32
        return v

    keys = np.random.default_rng(0).integers(0, 2**32, size=(50, 4), dtype=np.uint32)
    assert swarm_numbers.pcg4d(keys).tolist() == [reference([int(c) for c in key]) for key in keys]


def numbers(seed=0, iteration=0, particle=0, purpose=oracle.R1, size=256):
    """Return (size, size, 4) numbers of a square of texels."""
    y, x = np.mgrid[:size, :size]
    return swarm_numbers.random_uniform(seed, iteration, x, y, particle, purpose)


@pytest.mark.parametrize(
    "purpose", [oracle.R1, oracle.R1 + 1, oracle.R2, oracle.R2 + 1, oracle.POSITION, oracle.VELOCITY]
)
def test_numbers_are_uniform_in_every_dimension(purpose):
    for values in np.moveaxis(numbers(iteration=12, particle=5, purpose=purpose), -1, 0):
        assert stats.kstest(values.ravel(), "uniform").pvalue > BELIEVABLE
        assert values.min() >= 0 and values.max() < 1


def correlation_is_chance(a, b):
    """Whether two sets of numbers look independent: no correlation, and all cells of a 16×16 histogram equally full."""
    a, b = a.ravel(), b.ravel()
    counts = np.histogram2d(a, b, bins=16, range=((0, 1), (0, 1)))[0]
    return stats.pearsonr(a, b).pvalue > BELIEVABLE and stats.chisquare(counts.ravel()).pvalue > BELIEVABLE


OTHERS = {
    "another dimension": lambda a: numbers()[..., 1],
    "a dimension of the second block": lambda a: numbers(purpose=oracle.R1 + 1)[..., 0],
    "R2": lambda a: numbers(purpose=oracle.R2)[..., 0],
    "the next particle": lambda a: numbers(particle=1)[..., 0],
    "the next iteration": lambda a: numbers(iteration=1)[..., 0],
    "the next seed": lambda a: numbers(seed=1)[..., 0],
    "the texel to the right": lambda a: np.roll(a, -1, axis=1),
    "the texel above": lambda a: np.roll(a, -1, axis=0),
    "the transposed domain": lambda a: a.T[np.triu_indices(256, 1)],
}


@pytest.mark.parametrize("name", OTHERS)
def test_numbers_are_independent_of(name):
    first = numbers()[..., 0]
    other = OTHERS[name](first)
    assert correlation_is_chance(first[np.triu_indices(256, 1)] if other.ndim == 1 else first, other)


def test_low_bits_do_not_repeat_between_neighbours():
    y, x = np.mgrid[:256, :256]
    bits = swarm_numbers.random_bits(0, 0, x, y, 0, oracle.CHOICE)[..., 0] >> 8
    for low in range(4):
        bit = (bits >> low) & 1
        for axis in (0, 1):
            same = (bit == np.roll(bit, 1, axis)).sum()
            assert stats.binomtest(int(same), bit.size).pvalue > BELIEVABLE


@pytest.fixture(scope="module", params=[16, 13])
def choices(request):
    """(m, particles chosen by the move pass itself on 64×64 texels in 24 iterations, the same with another seed)."""
    context.ensure()
    domain = make_domain(64, 64, observations=1, holes=False)
    model = load_model("lambert")
    schedule = load_schedule("swarm").replaced(
        search=["diffuse"], iterations=100, particles=request.param, particles_per_dimension=0.0, c3=0.0
    )
    found = []
    for seed in (1, 2):
        shapes = {p.name: np.broadcast_to(np.float32(p.default), (64, 64, p.components)) for p in model.parameters}
        scale = np.ones((64, 64), np.float32)
        on_gpu = DomainTextures(domain, Packing(domain.solvable), domain.stack.values, scale)
        estimates, resolved = Estimates(model, shapes), resolve(schedule, model, set())[0]
        shared = PhaseContext(model, schedule, on_gpu, estimates, "fragment")
        stage = SequentialSwarmPhase(resolved, shared, seed)
        stage.iteration = 0
        moved = []
        for _ in range(24):
            for _ in stage.advance(Bands(), 1.0):
                pass
            moved.append(stage.read("verdict")[..., 3])
        stage.close()
        found.append(np.array(moved).astype(int))
    return request.param, *found


def independent(a, b, m):
    """Whether two choices look independent of each other, by the chi-square of their table."""
    table = np.bincount(a.ravel() * m + b.ravel(), minlength=m * m).reshape(m, m)
    return stats.chi2_contingency(table).pvalue > BELIEVABLE


def test_every_particle_is_chosen_equally_often(choices):
    m, chosen, _ = choices
    assert chosen.min() == 0 and chosen.max() == m - 1
    for part in (chosen, chosen[0], chosen[:, ::2, ::2], chosen[:, 0]):
        assert stats.chisquare(np.bincount(part.ravel(), minlength=m)).pvalue > BELIEVABLE


def test_neighbouring_texels_choose_independently(choices):
    m, chosen, _ = choices
    assert independent(chosen[:, :, 1:], chosen[:, :, :-1], m)
    assert independent(chosen[:, 1:], chosen[:, :-1], m)
    assert independent(chosen[:, 1:, 1:], chosen[:, :-1, :-1], m)


def test_successive_iterations_choose_independently(choices):
    m, chosen, _ = choices
    for lag in (1, 2, m):
        assert independent(chosen[lag:], chosen[:-lag], m)


def test_another_seed_chooses_otherwise(choices):
    m, chosen, other = choices
    assert independent(chosen, other, m)
    assert abs((chosen == other).mean() * m - 1) < 0.1
