"""Heights integrated from normals against heights that are known, and against scipy where there is no formula."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage, sparse
from scipy.fft import dctn
from scipy.sparse.linalg import spsolve

from irpso_addon.capture.camera import Camera
from irpso_addon.geometry.relief import height, relief
from irpso_addon.results.derived_map import height_map
from tests.builders.domains import unit
from tests.oracles import geometry as geometry_oracle


def waves(rows, columns):
    """Return a height in texels and its normals, by hand: z = Σ aᵢ sin(…)."""
    y, x = np.meshgrid(np.arange(rows) / columns, np.arange(columns) / columns, indexing="ij")
    z = columns * (0.05 * np.sin(9 * x + 2 * y) + 0.04 * np.cos(7 * y) * x)
    p = 0.45 * np.cos(9 * x + 2 * y) + 0.04 * np.cos(7 * y)
    q = 0.10 * np.cos(9 * x + 2 * y) - 0.28 * np.sin(7 * y) * x
    return z, unit(np.stack([-p, -q, np.ones_like(p)], axis=-1))


def masks(rows, columns):
    y, x = np.meshgrid((np.arange(rows) + 0.5) / rows, (np.arange(columns) + 0.5) / columns, indexing="ij")
    disc = (x - 0.5) ** 2 + (y - 0.5) ** 2 < 0.2
    tiles = ((5 * x % 1) > 0.15) & ((4 * y % 1) > 0.15) & ((x - 0.3) ** 2 + (y - 0.4) ** 2 > 0.02)
    return {"all": np.ones((rows, columns), bool), "disc": disc, "islands": tiles}


def off_by_a_constant(found, truth, covered):
    """Return the largest error in each island, of scipy's labelling, after its mean is taken away."""
    label, count = ndimage.label(covered)
    worst = 0.0
    for number in range(1, count + 1):
        here = label == number
        assert abs(found[here].mean()) < 1e-5
        difference = (found - truth)[here]
        worst = max(worst, np.abs(difference - difference.mean()).max())
    return worst


@pytest.mark.parametrize("where", ["all", "disc", "islands"])
def test_the_height_of_a_smooth_relief_is_recovered_in_any_mask(where):
    z, normals = waves(90, 127)
    covered = masks(90, 127)[where]
    camera = Camera.orthographic(127, 90, 3.0)
    found = relief.card_height(camera, normals, covered)
    error = off_by_a_constant(found.values, z, covered)
    print(f"\n{where}: off by {error:.4f} of {np.ptp(z):.1f} texels after {found.steps} steps")
    assert error < 0.01 and found.steps < 30 and (found.values[~covered] == 0).all()


def test_the_number_of_steps_does_not_grow_with_the_size():
    steps = []
    for size in (32, 256):
        _, normals = waves(size, size)
        steps.append(relief.card_height(Camera.orthographic(size, size, 1.0), normals, masks(size, size)["disc"]).steps)
    assert steps[1] < 1.5 * steps[0]


def test_a_ball_seen_in_perspective_is_recovered_round():
    camera = Camera(120, 100, (150.0, 170.0), (57.0, 52.0))
    rays = camera.points()
    centre, radius = np.array([0.1, -0.05, -6.0]), 1.4
    # |t r − c| = R, the nearer root.
    a, b, c = (rays**2).sum(-1), rays @ centre, centre @ centre - radius**2
    covered = b**2 - a * c > 0.15
    depth = np.where(covered, (b - np.sqrt(np.maximum(b**2 - a * c, 0))) / a, 6.0)
    normals = unit(depth[..., None] * rays - centre)
    found = relief.card_height(camera, normals, covered)
    # Depth is found up to a factor: the one that gives the truth's geometric mean.
    mean = np.exp(np.log(depth[covered]).mean())
    truth = (mean - depth) / mean * camera.scale[0]
    error = np.abs(found.values - truth)[covered]
    flat = relief.card_height(Camera.orthographic(120, 100, 1.0), normals, covered)
    wrong = np.abs(flat.values - flat.values[covered].mean() - truth + truth[covered].mean())[covered]
    print(f"\nball: off by {error.max():.4f} of {np.ptp(truth[covered]):.1f} texels, as orthographic {wrong.max():.2f}")
    assert error.max() < 0.01 * np.ptp(truth[covered]) < 0.5 * wrong.max()


def test_normals_that_contradict_each_other_are_integrated_as_scipy_does_it():
    rng = np.random.default_rng(5)
    rows, columns = 14, 19
    slopes, weights = rng.normal(size=(rows, columns, 2)), rng.uniform(0.02, 1, (rows, columns))
    covered = rng.random((rows, columns)) > 0.15
    number = np.arange(rows * columns).reshape(rows, columns)
    equations, right = [], []
    for y, x in zip(*np.nonzero(covered), strict=True):
        for dy, dx, axis in ((0, 1, 0), (1, 0, 1)):
            if y + dy < rows and x + dx < columns and covered[y + dy, x + dx]:
                weight = 2 / (1 / weights[y, x] + 1 / weights[y + dy, x + dx])
                row = np.zeros(rows * columns)
                row[number[y + dy, x + dx]], row[number[y, x]] = 1, -1
                equations.append(np.sqrt(weight) * row)
                right.append(np.sqrt(weight) * (slopes[y, x, axis] + slopes[y + dy, x + dx, axis]) / 2)
    matrix = sparse.csr_matrix(np.array(equations))
    # A little damping chooses among the constants; they are taken away below.
    truth = spsolve((matrix.T @ matrix + 1e-10 * sparse.eye(rows * columns)).tocsc(), matrix.T @ np.array(right))
    found, _ = height.integrate(slopes, weights, covered)
    assert off_by_a_constant(found, truth.reshape(rows, columns), covered) < 1e-3


def test_an_unseen_wall_does_not_bend_its_surroundings():
    z, normals = waves(64, 64)
    spoiled = normals.copy()
    spoiled[:, 30:32] = unit(np.array([1.0, 0.2, 0.0]))  # n_z = 0: the slope has no end
    camera, covered = Camera.orthographic(64, 64, 1.0), np.ones((64, 64), bool)
    found = relief.card_height(camera, spoiled, covered).values
    right = np.zeros_like(covered)
    right[:, 34:] = True
    left = np.zeros_like(covered)
    left[:, :28] = True
    for side in (left, right):
        difference = (found - z)[side]
        assert np.abs(difference - difference.mean()).max() < 0.3
    assert np.isfinite(found).all()


def test_a_height_picture_decodes_by_scale_and_midlevel():
    z, normals = waves(40, 40)
    covered = masks(40, 40)["disc"]
    found = relief.card_height(Camera.orthographic(40, 40, 1.0), normals, covered)
    picture = height_map(found).encoded[..., 0]
    assert picture[covered].min() == 0 and picture[covered].max() == 1
    np.testing.assert_allclose((picture[covered] - found.midlevel) * found.scale, found.values[covered], atol=1e-5)
    nothing = height.Height(np.zeros((4, 4), np.float32), np.ones((4, 4), bool), "texels")
    assert (height_map(nothing).encoded == nothing.midlevel).all()


@pytest.mark.parametrize("shape", [(13, 18), (1, 2), (3, 1)])
def test_the_cosine_transform_is_scipys_and_is_undone(shape):
    values = np.random.default_rng(1).normal(size=shape)
    forward = height._cosines(height._cosines(values, 1), 0)
    np.testing.assert_allclose(forward, dctn(values, type=2) / 4, atol=1e-12)
    np.testing.assert_allclose(height._cosines(height._cosines(forward, 0, True), 1, True), values, atol=1e-12)


def test_touching_islands_are_distinguished():
    right, left = geometry_oracle.plane(u_span=(0.5, 1.0)), geometry_oracle.plane(u_span=(0.0, 0.5), z=1.0)
    number = relief.uv_islands(geometry_oracle.joined(right, left))
    assert len(np.unique(number)) == 2 and len(np.unique(number[: len(right.uvs)])) == 1


@pytest.mark.parametrize("distortion", [(), (-0.25, 0.08, 0.01, -0.006)])
def test_a_slanting_card_is_flat_through_any_lens(distortion):
    camera = replace(Camera.from_fov(80, 60, 60, np.eye(4)), distortion=distortion)
    rays, normal = camera.points(), np.array([0.3, -0.2, 1.0]) / np.sqrt(1.13)
    depth = 2.0 / -(rays @ normal)  # along the axis, of the plane at distance 2
    found = relief.card_height(camera, np.broadcast_to(normal, rays.shape), np.ones((60, 80), bool))
    expected = camera.scale[0] * (1 - depth / np.exp(np.log(depth).mean()))
    assert np.ptp(expected) > 25
    np.testing.assert_allclose(found.values, expected, atol=0.02)
