"""Direct and indirect light, separated by their colour: against scipy's non-negative least squares in float64."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import nnls

from irpso_addon.geometry.domain import with_samples
from irpso_addon.solver.state.separation import SeparatedStack, direct_chroma, median_chromas, separation_of
from irpso_addon.solver.state.separation_record import Separation
from tests.builders.domains import make_domain

BRASS = np.array([0.5, 0.33, 0.17])
LIGHTS = 12


def chroma_of(light):
    return light / light.sum(axis=-1, keepdims=True)


def seen(light, intensities=None):
    """Return a domain whose samples are (K, H, W, 3) light under lights of intensity 1, and some of no weight."""
    rng = np.random.default_rng(2)
    intensities = rng.uniform(0.5, 3, (len(light), 3)) if intensities is None else intensities
    domain = make_domain(*light.shape[1:3], observations=len(light), holes=False)
    stack = np.ones((*light.shape[:3], 4))
    stack[..., :3] = light * intensities[:, None, None]
    return with_samples(replace(domain, intensities=np.float32(intensities)), np.float32(stack))


def hollow(shape=(6, 8), least=0.2):
    """Return (domain, direct light, indirect light, (H, W) bool where): the left half owes light to walls of brass."""
    rng = np.random.default_rng(4)
    direct = rng.uniform(0, 1, (LIGHTS, *shape, 1)) * BRASS
    where = np.broadcast_to(np.arange(shape[1]) < shape[1] // 2, shape)
    once, often = (rng.uniform(least, 1, (LIGHTS, *shape, 1)) * chroma_of(BRASS**power) for power in (2, 4))
    thrown = (once + 0.2 * often) * where[..., None]
    return seen(direct + thrown), direct, thrown, where


def found(domain, indirect, least=0.05):
    rows, columns = np.nonzero(domain.solvable)
    direct = direct_chroma(median_chromas(domain, rows, columns), indirect[rows, columns])
    assert direct is not None
    return direct, separation_of(domain, indirect, direct, least)


def test_a_hollow_of_brass_is_left_with_its_direct_light():
    domain, direct, thrown, where = hollow()
    chroma, separation = found(domain, where)
    np.testing.assert_allclose(chroma, BRASS, atol=2e-3)
    np.testing.assert_array_equal(separation.separated, where)
    left = SeparatedStack(domain, separation)
    for observation in range(LIGHTS):
        light = left.layer(observation)[..., :3] / domain.intensities[observation]
        np.testing.assert_allclose(light, direct[observation], atol=0.004)
    share = thrown.sum(axis=(0, -1)) / (direct + thrown).sum(axis=(0, -1))
    np.testing.assert_allclose(separation.indirect_share, share, atol=0.004)


def test_samples_match_non_negative_least_squares():
    rng = np.random.default_rng(7)
    domain = seen(rng.uniform(0, 1, (LIGHTS, 3, 5, 3)) ** 2)
    own = chroma_of(rng.uniform(0.1, 1, (3, 5, 3)))
    chromas = np.stack([own, chroma_of(own * BRASS), chroma_of(own * BRASS**3)], axis=-2)
    separation = Separation.of_colours(chromas[..., 0, :2], chromas[..., 1, :2], np.zeros((3, 5)))
    left = SeparatedStack(domain, separation)
    light, some = domain.stack.values[..., :3] / domain.intensities[:, None, None].astype(np.float64), 0
    for k, y, x in np.ndindex(LIGHTS, 3, 5):
        parts, _ = nnls(chromas[y, x].T, light[k, y, x])
        some += (parts > 0).sum()
        wanted = np.maximum(light[k, y, x] - parts[1:] @ chromas[y, x, 1:], 0) * domain.intensities[k]
        np.testing.assert_allclose(left.layer(k)[y, x, :3], wanted, atol=1e-5)
        removed = light[k, y, x] - wanted / domain.intensities[k]
        kept = np.linalg.norm(light[k, y, x] - removed)
        weight = max(0.1, np.cos(np.arctan2(np.linalg.norm(removed), kept)) ** 2)
        np.testing.assert_allclose(left.layer(k)[y, x, 3], weight, atol=1e-5)
        np.testing.assert_array_equal(left.texels(np.array([y]), np.array([x]))[k, 0], left.layer(k)[y, x])
    assert LIGHTS * 15 < some < 3 * LIGHTS * 15  # samples with one, two and three parts
    np.testing.assert_array_equal(left.subset(np.array([3])).layer(0), left.layer(3))
    np.testing.assert_array_equal(left.window(slice(1, 3), slice(2, 4)).layer(3), left.layer(3)[1:3, 2:4])


def test_bounds_and_samples_of_no_weight_stay():
    domain, _, _, where = hollow()
    values = domain.stack.values.copy()
    values[0, ..., 3], values[1, ..., 3], values[1, ..., :3] = -2.5, 0, np.nan
    domain = with_samples(domain, values)
    left = SeparatedStack(domain, found(domain, where)[1])
    for observation in (0, 1):
        np.testing.assert_array_equal(left.layer(observation), domain.stack.layer(observation))
    assert (left.layer(2)[where] != domain.stack.layer(2)[where]).any()


def test_a_texel_of_another_saturation_keeps_its_light_where_the_shading_is_direct():
    domain, direct, thrown, where = hollow((6, 16))
    red, light = np.argwhere(~where)[:4], direct + thrown
    for y, x in red:
        light[:, y, x] = light[:, y, x].sum(axis=-1, keepdims=True) * chroma_of(BRASS**1.6)
    suspected = where & (np.arange(16) < 7)
    _, separation = found(seen(light), suspected)
    assert not separation[tuple(red.T)].any()
    # The last column of the hollow is separated by its colour alone.
    assert separation.separated[:, 7].all()


def test_a_checkpoint_holds_two_chromas_the_share_and_nine_harmonics():
    colours = Separation.of_colours(np.array([[0.5, 0.3]]), np.array([[0.6, 0.2]]), np.array([0.4]))
    np.testing.assert_array_equal(colours.values, np.float32([[0.5, 0.3, 0.6, 0.2, 0.4, *[0] * 9]]))
    shadows = Separation.of_shadows(np.array([[*range(1, 10), 0.7, 0.0, 0.25], [0.0] * 12]))
    np.testing.assert_array_equal(shadows.values, np.float32([[0.7, 1e-6, 0, 0, 0.25, *range(1, 10)], [0] * 14]))
    both = Separation(np.concatenate([colours.values, shadows.values]))
    np.testing.assert_array_equal(both.separated, [True, True, False])
    np.testing.assert_array_equal(both.by_colour, [True, False, False])


def refused(kind):
    domain, direct, thrown, where = hollow()
    light, indirect = direct + thrown, where
    if kind == "no shading tells of it":
        indirect = np.zeros_like(where)
    elif kind == "grey":
        light = seen_grey(light)
    elif kind == "many colours":
        rng = np.random.default_rng(3)
        light = light * rng.uniform(0.3, 1, (*where.shape, 3))
    elif kind == "velvet":  # its rim is paler, not more saturated
        light = direct + thrown.sum(axis=-1, keepdims=True) / 3
    elif kind == "another colour":
        light = direct + thrown.sum(axis=-1, keepdims=True) * (0.1, 0.2, 0.7)
    domain = seen(light)
    rows, columns = np.nonzero(domain.solvable)
    return direct_chroma(median_chromas(domain, rows, columns), indirect[rows, columns])


def seen_grey(light):
    return np.repeat(light.mean(axis=-1, keepdims=True), 3, axis=-1)


@pytest.mark.parametrize("kind", ["no shading tells of it", "grey", "many colours", "velvet", "another colour"])
def test_nothing_is_separated_where_colour_cannot_tell(kind):
    assert refused(kind) is None
    assert refused("nothing wrong") is not None
