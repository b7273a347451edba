"""Materials that the whole surface shares: what texels elsewhere tell of those that show no highlight."""

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.geometry.domain import with_samples
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.engine.recovery import Recovery
from irpso_addon.solver.settings.schedule import load_schedule
from tests.builders.domains import make_domain, unit
from tests.oracles import confidence as confidence_oracle

pytestmark = pytest.mark.usefixtures("gpu")

MODEL = load_model("metallic_roughness")
SHAPE = (16, 24)
STANDARD = load_schedule("standard").replaced(
    prior_rounds=0, surface_rounds=0, refinement_rounds=0, neighbour_interval=0, c3=0.0
)
SMOOTH, MATT = 0.12, 0.8


@pytest.fixture(scope="module")
def card():
    """A polished half and a matt half of other colours; 60 % of the smooth texels face where no light is mirrored."""
    rng = np.random.default_rng(7)
    height, width = SHAPE
    smooth = np.zeros(SHAPE, bool)
    smooth[:, : width // 2] = True
    lights = unit(np.stack([*(rng.uniform(-1, 1, (2, 14))), np.full(14, 0.9)], axis=1))
    mirrors = unit(lights + (0, 0, 1))
    tilt = rng.uniform(-0.3, 0.3, (*SHAPE, 2))
    sees = smooth & (rng.uniform(size=SHAPE) < 0.4)
    tilt[sees] = (mirrors[:, :2] / mirrors[:, 2:])[rng.integers(0, 14, sees.sum())] + rng.normal(
        0, 0.01, (sees.sum(), 2)
    )
    truth = {
        "normal": unit(np.concatenate([tilt, np.ones((*SHAPE, 1))], axis=-1)),
        "base_color": np.where(smooth[..., None], (0.05, 0.12, 0.3), (0.5, 0.3, 0.15))
        * rng.uniform(0.9, 1.1, (*SHAPE, 1)),
        "roughness": np.where(smooth, SMOOTH, MATT)[..., None],
        "metallic": np.zeros((*SHAPE, 1)),
        "specular": np.full((*SHAPE, 1), 0.5),
    }
    made = make_domain(*SHAPE, observations=14, holes=False)
    made = replace(made, lights=np.pad(lights, ((0, 0), (0, 1))).astype(np.float32))
    stack = np.ones((14, *SHAPE, 4))
    stack[..., :3] = confidence_oracle.radiance(made, "metallic_roughness", truth)
    stack[..., :3] += rng.normal(0, 0.002, stack[..., :3].shape)
    return with_samples(made, np.maximum(stack, 0).astype(np.float32)), smooth, sees


def roughness(domain, **settings):
    with Recovery(domain, MODEL, STANDARD.replaced(**settings), 1) as recovery:
        recovery.step()
        return recovery.maps(confidence=False).values["roughness"][..., 0]


def test_an_unseen_lobe_is_recovered_from_texels_of_the_same_material(card):
    domain, smooth, sees = card
    alone, shared = roughness(domain, materials_rounds=0), roughness(domain)
    unseen = smooth & ~sees
    assert np.mean(np.abs(alone[unseen] - SMOOTH) > 0.2) > 0.05
    assert np.mean(np.abs(shared[unseen] - SMOOTH) > 0.2) < 0.02
    # Who tells its own is left alone, and so is the other material.
    assert np.median(np.abs(shared[sees] - SMOOTH)) < 0.01
    assert np.median(np.abs(shared[~smooth] - MATT)) <= np.median(np.abs(alone[~smooth] - MATT)) + 0.02


def test_dark_photographs_weigh_as_much_against_priors_as_bright_ones(card):
    # With squared errors a fitness is in units of radiance: its noise floor must follow them.
    domain, _, _ = card
    values = domain.stack.values.copy()
    values[..., :3] /= 16
    dark = replace(with_samples(domain, values), intensities=domain.intensities / 16)
    np.testing.assert_allclose(roughness(dark, loss="l2"), roughness(domain, loss="l2"), atol=0.02)


def test_a_lone_texel_keeps_its_material_if_its_samples_decide(card):
    domain, smooth, _ = card
    stack = domain.stack.values.copy()
    stack[:, 8, 4], stack[:, 3, 7] = domain.stack.values[:, 8, 20], domain.stack.values[:, 3, 15]
    found = roughness(with_samples(domain, stack))
    alone = roughness(with_samples(domain, stack), materials_rounds=0)
    for texel in ((8, 4), (3, 7)):
        assert abs(found[texel] - alone[texel]) < 0.2 and found[texel] > 0.4


@pytest.mark.parametrize("stop", [1, 4, 7, 8], ids=lambda n: f"after-{n}")
def test_a_checkpoint_within_a_round_resumes_to_the_same_maps(card, stop, tmp_path):
    schedule = STANDARD.replaced(materials_iterations=3, iterations=2)
    with Recovery(card[0], MODEL, schedule, 1) as whole:
        progress = whole.step()
        wanted = whole.maps(confidence=False)
    with Recovery(card[0], MODEL, schedule, 1) as first:
        while not (first.progress.title == "shared materials" and first.progress.iteration == stop - 1):
            first.step(iterations=1)
        first.save(tmp_path / "run.npz")
    with Recovery(card[0], MODEL, schedule, 1) as second:
        second.load(tmp_path / "run.npz")
        assert second.step() == progress
        found = second.maps(confidence=False)
    for name, value in wanted.values.items():
        assert found.values[name].tobytes() == value.tobytes(), name
