"""Bakes against brute-force float64 rasterisers, and projections there and back."""

import math
from dataclasses import replace

import bpy
import numpy as np
import pytest
from mathutils import Matrix, Vector

from irpso_addon.blender.mesh import extract_mesh
from irpso_addon.capture.camera import Camera
from irpso_addon.capture.types import Capture, Light, Observation
from irpso_addon.core.errors import InputError
from irpso_addon.geometry.build import domain_from_mesh
from irpso_addon.geometry.project import Projector
from irpso_addon.geometry.surface import bake
from irpso_addon.gpu import raster
from tests.oracles import geometry as oracle

ROUNDING = 1 / 128  # texels: hardware moves corners to a grid of 1/256, so nearer to an edge coverage is its choice


@pytest.fixture(autouse=True)
def empty_file():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def monkey(levels=0, **placing):
    bpy.ops.mesh.primitive_monkey_add()
    obj = bpy.context.object
    for name, value in placing.items():
        setattr(obj, name, value)
    if levels:
        obj.modifiers.new("subdivision", "SUBSURF").levels = levels
    bpy.context.view_layer.update()
    return obj


def looking(position, target=(0, 0, 0)):
    """Return the matrix of a camera at a position that looks at a target."""
    direction = Vector(position) - Vector(target)
    placed = Matrix.Translation(position) @ direction.to_track_quat("Z", "Y").to_matrix().to_4x4()
    return np.array(placed, np.float64)


def cameras():
    place = looking((1.5, -3.5, 1.2))
    return {
        "perspective off centre": Camera(61, 47, (70.0, 66.0), (25.3, 28.1), place),
        "orthographic": Camera(47, 61, (17.0, 19.0), (23.9, 28.0), place, False),
    }


def toward(camera, positions):
    """Return unit vectors from positions to a camera."""
    return oracle.unit(camera.position - positions) if camera.perspective else camera.backward


def assert_same_bake(drawn, expected, clear):
    """Compare where both are sure: the pixel's centre is not on an edge, where rounding chooses the triangle."""
    assert (drawn.coverage == expected.coverage)[clear].all()
    both = drawn.coverage & expected.coverage & clear
    assert both.sum() > 0.1 * both.size
    for name, tolerance in (
        ("position", 2e-5),
        ("normal", 2e-5),
        ("tangent", 2e-4),
        ("uv", 2e-5),
        ("face_normal", 1e-4),
    ):
        error = np.abs(getattr(drawn, name) - getattr(expected, name))[both].max()
        assert error < tolerance, f"{name} is off by {error}"
    assert (drawn.triangle == expected.triangle)[both].all()
    for name in ("position", "normal", "tangent", "uv"):
        assert (getattr(drawn, name)[~drawn.coverage] == 0).all()


@pytest.mark.parametrize(("width", "height"), [(64, 64), (45, 67), (1, 1), (150, 25)])
def test_a_uv_bake_agrees_with_a_float64_rasteriser_at_odd_sizes_and_across_seams(width, height):
    mesh = oracle.joined(
        oracle.sphere(columns=9, rows=7), replace(oracle.plane(), uvs=oracle.plane().uvs * 0)
    )  # a seam at longitude 0, and a part with no texels
    drawn = bake.bake_uv(mesh, width, height)
    expected, distance = oracle.bake_uv(mesh, width, height)
    if width * height == 1:
        assert drawn.coverage.all()
        return
    assert_same_bake(drawn, expected, distance > ROUNDING)


def test_mirrored_texture_coordinates_give_the_other_sign_and_the_same_normal_frame():
    right = oracle.plane(u_span=(0.5, 1.0))
    left = oracle.plane(u_span=(0.5, 0.0), z=1.0)
    flipped = left.tangents.copy() * np.float32([-1, -1, -1, -1])
    drawn = bake.bake_uv(oracle.joined(right, replace(left, tangents=flipped)), 32, 16)
    assert (drawn.tangent[:, :16] == np.float32([-1, 0, 0, -1])).all()
    assert (drawn.tangent[:, 16:] == np.float32([1, 0, 0, 1])).all()
    bitangent = drawn.tangent[..., 3:] * np.cross(drawn.normal, drawn.tangent[..., :3])
    np.testing.assert_array_equal(bitangent, np.broadcast_to([0, 1, 0], bitangent.shape))


def test_the_frame_of_every_texel_is_orthonormal():
    drawn = bake.bake_uv(extract_mesh(monkey()), 150, 225)
    n, t = drawn.normal[drawn.coverage], drawn.tangent[drawn.coverage][:, :3]
    for error in (np.linalg.norm(n, axis=1) - 1, np.linalg.norm(t, axis=1) - 1, (n * t).sum(1)):
        assert np.abs(error).max() < 1e-6


@pytest.mark.parametrize("name", ["perspective off centre", "orthographic"])
def test_a_camera_bake_agrees_with_a_float64_ray_caster(name):
    camera, mesh = cameras()[name], oracle.sphere(columns=12, rows=8)
    mesh = oracle.joined(mesh, oracle.sphere(0.3, 8, 6, (1.0, -1.2, 0.3)))
    expected, distance = oracle.bake_camera(mesh, camera)
    # Seen edge on, a surface's depth multiplies the rounding of the pixel's place.
    edge_on = expected.coverage & (np.abs((expected.face_normal * toward(camera, expected.position)).sum(-1)) < 0.2)
    assert_same_bake(bake.bake_camera(mesh, camera), expected, (distance > ROUNDING) & ~edge_on)


@pytest.mark.parametrize("name", ["perspective off centre", "orthographic"])
def test_a_camera_wider_than_the_largest_texture_is_drawn_in_blocks(name, monkeypatch):
    camera, mesh, sizes = cameras()[name], oracle.sphere(columns=12, rows=8), []
    draw = raster.rasterize
    monkeypatch.setattr(bake.context, "max_texture_size", lambda: 24)
    monkeypatch.setattr(raster, "rasterize", lambda *given: sizes.append(given[2:4]) or draw(*given))
    drawn = bake.bake_camera(mesh, camera)
    assert len(sizes) == 6 and np.max(sizes) == 24
    expected, distance = oracle.bake_camera(mesh, camera)
    edge_on = expected.coverage & (np.abs((expected.face_normal * toward(camera, expected.position)).sum(-1)) < 0.2)
    assert_same_bake(drawn, expected, (distance > ROUNDING) & ~edge_on)


def test_a_surface_that_passes_behind_the_camera_is_cut_at_the_camera():
    floor = oracle.plane(40.0, columns=1, rows=1)
    camera = Camera(40, 30, (30.0, 30.0), (20.0, 15.0), looking((0, 0, 1.0), (0, 5, 0.5)))
    drawn = bake.bake_camera(floor, camera)
    expected, _ = oracle.bake_camera(floor, camera)
    assert (drawn.coverage == expected.coverage).all() and 200 < drawn.coverage.sum() < 1200
    np.testing.assert_allclose(drawn.position, expected.position, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("name", ["perspective off centre", "orthographic"])
def test_the_surface_point_of_a_pixel_projects_to_its_centre(name):
    camera = cameras()[name]
    camera = replace(
        camera, width=camera.width * 8, height=camera.height * 8,
        scale=tuple(8 * s for s in camera.scale), centre=tuple(8 * c for c in camera.centre),
    )  # fmt: skip
    drawn = bake.bake_camera(extract_mesh(monkey(2)), camera)
    y, x = np.nonzero(drawn.coverage)
    pixels, _ = camera.project(drawn.position[drawn.coverage].astype(np.float64))
    assert len(x) > 20000 and np.abs(pixels - np.stack([x + 0.5, y + 0.5], -1)).max() < 1e-3


def smooth(position):
    """Return an RGB radiance that changes slowly over space."""
    x, y, z = np.moveaxis(np.asarray(position, np.float64), -1, 0)
    return np.stack([0.6 + 0.3 * np.sin(2 * x + y), 0.5 + 0.2 * z * x, 0.4 + 0.3 * np.cos(1.5 * z - y)], -1)


def photograph(mesh, camera):
    seen = bake.bake_camera(mesh, camera)
    image = np.zeros((camera.height, camera.width, 4), np.float32)
    image[seen.coverage, :3] = smooth(seen.position[seen.coverage])
    image[..., 3] = seen.coverage
    return image


def test_radiance_from_two_sides_returns_to_its_texels():
    mesh = extract_mesh(monkey(2))
    pair = tuple(Camera.from_fov(300, 240, 40, looking((x, -3, 0.6))) for x in (-3.0, 3.0))
    images = [photograph(mesh, camera) for camera in pair]
    observations = tuple(
        Observation(f"side {k}", lambda k=k: images[k], Light((0, 0, 2), distant=False), camera=k) for k in (0, 1)
    )
    taken = Capture("two sides", observations, pair, tuple(np.ones((240, 300), bool) for _ in pair))
    domain = domain_from_mesh(taken, mesh, 150, 225, shadows=False, areas=False)
    weight = domain.stack.values[..., 3] > 0
    assert not domain.card and (weight <= domain.bake.coverage).all()
    error = np.abs(domain.stack.values[..., :3] - smooth(domain.bake.position))
    surface = bake.bake_uv(mesh, 150, 225)
    pixel = 5.0 / pair[0].scale[0]
    for k, camera in enumerate(pair):
        spacing = pixel / (toward(camera, domain.bake.position) * surface.face_normal).sum(-1)[weight[k]]
        # Bilinear, two directions: h²/8 of a second derivative of at most 1.5, for pixels h apart on the surface.
        bilinear = 2 * spacing**2 / 8 * 1.5
        # That is on a plane. Where the mesh bends, the four pixels may leave the texel's plane by half a pixel, which
        # along the view is half a spacing; the radiance's slope is at most 0.75.
        bound = bilinear + 0.75 * 0.5 * spacing
        worst = error[k].max(-1)[weight[k]]
        assert (worst < bound).all() and (worst < bilinear).mean() > 0.8
    # Each sees its own half, and the two together more than either.
    x = domain.bake.position[..., 0]
    for k, side in enumerate((-1, 1)):
        assert (side * x[weight[k]]).mean() > 0.1 and 0.15 < weight[k].sum() / domain.bake.coverage.sum() < 0.5
    assert weight.any(0).sum() > 1.2 * max(weight[0].sum(), weight[1].sum())
    np.testing.assert_allclose(domain.views, [[*camera.position, 1] for camera in pair], rtol=1e-6)
    np.testing.assert_array_equal(domain.lights, [[0, 0, 2, 1]] * 2)


def test_a_mesh_that_no_image_shows_is_refused():
    mesh, camera = oracle.plane(), Camera.from_fov(8, 8, 40, looking((0, 0, 3), (0, 0, 9)))
    image, mask = np.ones((8, 8, 4), np.float32), np.ones((8, 8), bool)
    taken = Capture("away", (Observation("one", lambda: image, Light((0, 0, 1))),), (camera,), (mask,))
    with pytest.raises(InputError, match="no image of capture 'away' shows mesh 'test'"):
        domain_from_mesh(taken, mesh, 8, 8)
    facing = replace(taken, cameras=(Camera.from_fov(8, 8, 40, looking((0, 0, 3))),))
    assert domain_from_mesh(facing, mesh, 8, 8).solvable.sum() > 30
    with pytest.raises(InputError, match="shows mesh 'test' lit; check its cameras, masks"):
        domain_from_mesh(replace(facing, masks=(~mask,)), mesh, 8, 8)
    with pytest.raises(InputError, match="no texel of 2 × 2 lies on 'test'"):
        domain_from_mesh(facing, replace(mesh, uvs=mesh.uvs * np.float32(0.1)), 2, 2)


def test_no_texel_is_seen_through_another_part_of_the_mesh():
    mesh = extract_mesh(monkey(1))
    camera = Camera.from_fov(200, 160, 40, looking((3.0, -3, 0.6)))
    texels = bake.bake_uv(mesh, 96, 96)
    visible = Projector(texels, bake.bake_camera(mesh, camera), camera).visible
    points = texels.position[visible].astype(np.float64)
    away = toward(camera, points)
    a, b, c = (mesh.positions[None, :, k].astype(np.float64) for k in range(3))
    pixel = 5.0 / camera.scale[0]
    hit = np.zeros(len(points), bool)
    for start in range(0, len(points), 200):
        ray, origin = away[start : start + 200, None], points[start : start + 200, None]
        p = np.cross(ray, c - a)
        det = ((b - a) * p).sum(-1)
        det = np.where(np.abs(det) < 1e-14, np.inf, det)
        s = origin - a
        q = np.cross(s, b - a)
        u, v, along = (s * p).sum(-1) / det, (ray * q).sum(-1) / det, ((c - a) * q).sum(-1) / det
        # Nearer than a grazing pixel's length it may be the same surface.
        hit[start : start + 200] = ((u >= 0) & (v >= 0) & (u + v <= 1) & (along > 10 * pixel)).any(1)
    assert len(points) > 1000 and hit.mean() < 0.002


def test_more_triangles_than_float32_numbers_tell_apart_are_refused():
    limit = raster.MAX_TRIANGLES
    assert int(np.float32(limit)) == limit and int(np.float32(limit + 2)) != limit + 2
    one = oracle.plane(columns=1, rows=1)
    parts = {k: getattr(one, k)[:1] for k in ("positions", "normals", "tangents", "uvs")}
    most = {k: np.broadcast_to(part, (limit, *part.shape[1:])) for k, part in parts.items()}
    mesh = replace(one, **most, occluders=parts["positions"])  # without memory: every triangle is the same
    camera = Camera.from_fov(8, 8, 40, looking((0, 0, 3)))
    for draw in (lambda: bake.bake_uv(mesh, 8, 8), lambda: bake.bake_camera(mesh, camera)):
        with pytest.raises(InputError, match="'test' has 16777215 triangles, its occluders 1; the limit is 16777215"):
            draw()


def test_overlapping_texture_coordinates_are_refused_unless_allowed():
    one = oracle.plane(u_span=(0, 0.75))
    both = oracle.joined(one, oracle.plane(z=1, u_span=(0.5, 1.0)))
    assert bake.overlap(both) == pytest.approx(0.25, abs=1e-3)
    with pytest.raises(InputError, match="'UVMap' of 'test' overlaps itself over 25 %"):
        bake.bake_uv(both, 16, 16)
    assert bake.bake_uv(both, 16, 16, allow_overlap=True).coverage.all()
    assert bake.overlap(one) == 0 and bake.overlap(extract_mesh(monkey(1))) < 1e-4


def test_a_million_triangles_are_drawn():
    mesh = oracle.plane(columns=1000, rows=500)
    drawn = bake.bake_uv(mesh, 200, 100, allow_overlap=True)
    assert drawn.coverage.all() and drawn.triangle.max() > 990_000
    x, y = np.meshgrid((np.arange(200) + 0.5) / 100 - 1, (np.arange(100) + 0.5) / 50 - 1)
    np.testing.assert_allclose(drawn.position[..., :2], np.stack([x, y], -1), atol=1e-5)


def test_baking_restores_the_drawing_state():
    import gpu

    bake.bake_uv(oracle.plane(), 4, 4)
    gpu.state.blend_set("ALPHA")
    gpu.state.depth_test_set("LESS_EQUAL")
    bake.bake_uv(oracle.plane(), 4, 4)
    assert (gpu.state.blend_get(), gpu.state.depth_test_get()) == ("ALPHA", "LESS_EQUAL")
    gpu.state.blend_set("NONE")
    gpu.state.depth_test_set("NONE")
    assert math.isclose(raster.triangle_numbers(np.zeros((1, 3, 4)), 2, 2, first=True).sum(), 0)
