"""Reliefs of large cards: triangles that are coarser than the texels, against those that are not."""

import bpy  # noqa: F401 (mathutils comes with it)
import numpy as np
import pytest

from irpso_addon.blender.ray_caster import ray_caster
from irpso_addon.capture.camera import Camera
from irpso_addon.core.steps import run_steps
from irpso_addon.geometry.domain import flat_bake
from irpso_addon.geometry.light.card_relief import card_surface_steps, relief_stride, relief_triangles
from irpso_addon.geometry.light.light_transport import lit_steps

HEIGHT, WIDTH = 150, 201  # no multiples of the strides


def crater(perspective=False):
    """Return camera, card, covered texels and normals of a round hollow with steep walls."""
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    away = np.hypot(x - WIDTH / 2, y - HEIGHT / 2) / WIDTH
    return card(20 * np.tanh(20 * (away - 0.2)), np.hypot(x - WIDTH / 2, y - HEIGHT / 2) < 74, perspective)


def card(heights, covered, perspective=False):
    """Return camera, card, covered texels and normals (H, W, 3) of heights (H, W) in texels."""
    down, along = np.gradient(heights)
    normals = np.stack([-along, -down, np.ones_like(along)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    if perspective:
        camera = Camera.from_fov(WIDTH, HEIGHT, 30.0)
        places = camera.points(5.0)
    else:
        camera = Camera.orthographic(WIDTH, HEIGHT, 2.0)
        places = camera.points(0.0) * (1, 1, 0)
    y, x = (np.mgrid[:HEIGHT, :WIDTH] + 0.5) / np.array([HEIGHT, WIDTH])[:, None, None]
    return camera, flat_bake(places, covered, np.stack([x, y], axis=-1)), covered, normals


def surface(subject, stride):
    return run_steps(card_surface_steps(*subject, stride))


def test_small_cards_are_as_fine_as_their_texels_and_large_ones_bounded():
    assert relief_stride((512, 612), 64) == relief_stride((640, 640), 64) == 1
    assert relief_stride((3000, 4000), 64) == 7
    assert 64 * 4 <= 4000 / relief_stride((3000, 4000), 256) <= 1024
    assert relief_triangles((512, 612), 64) == 2 * 512 * 612
    for size in (641, 1000, 4000, 20000):
        for resolution in (8, 64, 256, 1024):
            assert relief_triangles((size, size), resolution) <= 2 * 1024**2
            assert size / relief_stride((size, size), resolution) > 320


@pytest.mark.parametrize("perspective", [False, True])
@pytest.mark.parametrize("stride", [2, 4])
def test_a_coarse_relief_is_as_deep_and_has_few_triangles(perspective, stride):
    subject = crater(perspective)
    full, bake = surface(subject, 1)
    coarse, coarse_bake = surface(subject, stride)
    assert len(coarse.positions) < 1.05 * len(full.positions) / stride**2
    texel = 2 / WIDTH if not perspective else 5 / subject[0].scale[0]
    heights, others = (each.position[subject[2]][:, 2] / texel for each in (bake, coarse_bake))
    assert np.ptp(heights) > 35
    assert np.ptp(others) == pytest.approx(np.ptp(heights), rel=0.02)
    assert np.abs(heights - others - (heights - others).mean()).max() < 0.4 * stride
    assert np.ptp(coarse.positions[..., 2]) / texel == pytest.approx(np.ptp(heights), rel=0.03)
    np.testing.assert_array_equal(coarse_bake.normal, bake.normal)


def test_texels_lie_on_the_coarse_triangles():
    subject = crater()
    mesh, bake = surface(subject, 4)
    inner = np.zeros((HEIGHT, WIDTH), bool)
    inner[30:-30, 50:-50] = True  # no rim
    points = bake.position[inner].astype(np.float64)
    cast = ray_caster(mesh)
    triangle, place = cast(points + (0, 0, 1), np.broadcast_to((0.0, 0.0, -1.0), points.shape))
    assert (triangle >= 0).all()
    np.testing.assert_allclose(place, points, atol=1e-5)


def test_lights_reach_the_same_places_of_a_coarse_relief():
    subject = crater()
    around = np.arange(16) * 2.4
    low = np.radians(np.linspace(15, 70, 16))
    lights = np.stack([np.cos(around) * np.cos(low), np.sin(around) * np.cos(low), np.sin(low), 0 * low], axis=-1)
    texels = np.flatnonzero(subject[2])[::7]
    full, coarse = (
        run_steps(lit_steps(mesh, bake, texels, lights, ray_caster(mesh)))
        for mesh, bake in (surface(subject, stride) for stride in (1, 2))
    )
    assert 0.1 < 1 - full.mean() < 0.5  # what it is about
    assert (full != coarse).mean() < 0.02
    assert abs(full.mean() - coarse.mean()) < 0.005


def test_islands_stay_apart_where_a_cell_covers_the_gap():
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    left = x < 101
    covered = (x != 101) & (y > 5)
    subject = card(np.where(left, 0.5 * (y - 75), -0.5 * (y - 75)), covered)
    subject[3][:, 100:103] = subject[3][:, [99, 99, 104]]
    mesh, _ = surface(subject, 4)
    right = mesh.positions[..., 0] > subject[1].position[0, 101, 0]
    assert (right.all(axis=1) | ~right.any(axis=1)).all()
    assert right.any() and not right.all()
