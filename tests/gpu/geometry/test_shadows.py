"""Shadows that a mesh predicts, against geometry, rays and Cycles."""

from dataclasses import replace

import bpy
import numpy as np
import pytest
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from irpso_addon.blender.mesh import extract_mesh
from irpso_addon.capture.camera import Camera
from irpso_addon.capture.types import Capture, Light, Observation
from irpso_addon.geometry import build
from irpso_addon.geometry.build import domain_from_mesh
from irpso_addon.geometry.light import shadows
from irpso_addon.geometry.surface import bake
from tests.oracles import geometry as oracle

SIZE = (128, 64)
BALL, RADIUS = np.array([0.1, -0.05, 0.45]), 0.3
ABOVE = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1.0]])
INSIDE = (-0.4, 0.3, 0.7)  # a light within the sphere around the mesh


@pytest.fixture(autouse=True)
def empty_file():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def scaled(mesh, scale, shift):
    return replace(mesh, positions=(mesh.positions * np.float32(scale) + np.float32(shift)))


def ball_over_floor(scale=1.0, shift=(0.0, 0.0, 0.0)):
    """Return a floor, in the left half of the texture, and a ball above it, in the right."""
    floor = oracle.plane(2.0, columns=1, rows=1, u_span=(0, 0.5))
    ball = oracle.sphere(RADIUS, 64, 32, BALL)
    ball = replace(ball, uvs=ball.uvs * np.float32([0.5, 1]) + np.float32([0.5, 0]))
    return scaled(oracle.joined(floor, ball), scale, shift)


def caster_of(mesh, size=SIZE):
    texels = bake.bake_uv(mesh, *size)
    return texels, shadows.ShadowCaster(mesh, texels, shadows.texel_size(mesh, texels))


def all_weights(mesh, light, size=SIZE):
    """Return the bake and the (H, W) weights of all its texels."""
    texels, caster = caster_of(mesh, size)
    weights = np.zeros(texels.coverage.shape, np.float32)
    covered = np.flatnonzero(texels.coverage)
    weights.ravel()[covered] = caster.weights(light, covered)
    return texels, weights


def gap_to_ball(points, light):
    """Return how far the way from points (…, 3) to a light passes the ball's surface by; below 0 it is hidden."""
    vector = np.asarray(light.vector, np.float64)
    toward = np.broadcast_to(vector, points.shape) if light.distant else vector - points
    unit = oracle.unit(toward)
    away = BALL - points
    along = (away * unit).sum(-1)
    end = np.inf if light.distant else np.linalg.norm(toward, axis=-1)
    nearest = points + np.clip(along, 0, end)[..., None] * unit
    return np.linalg.norm(nearest - BALL, axis=-1) - RADIUS


@pytest.mark.parametrize(("scale", "shift"), [(1e-3, 0), (1.0, 0), (1e3, 0), (1.0, 50.0)])
@pytest.mark.parametrize(("vector", "distant"), [((0.5, 0.3, 0.8), True), ((0.9, -0.8, 2.6), False), (INSIDE, False)])
def test_the_shadow_of_a_ball_on_a_floor_is_where_geometry_has_it_at_any_scale(vector, distant, scale, shift):
    shift = np.full(3, shift)
    unit_light = Light(tuple(oracle.unit(np.array(vector)) if distant else vector), distant=distant)
    light = unit_light if distant else replace(unit_light, vector=tuple(scale * np.array(vector) + shift))
    texels, weights = all_weights(ball_over_floor(scale, shift), light)
    points = (texels.position.astype(np.float64) - shift) / scale
    floor = texels.coverage & (texels.uv[..., 0] < 0.5)
    gap = gap_to_ball(points, unit_light)
    border = 2 * 2.0 / 64  # two texels
    hidden, lit = floor & (gap < -border), floor & (gap > border)
    assert hidden.sum() > 80 and lit.sum() > 2000
    assert (weights[hidden] == 0).all() and (weights[lit] == 1).all()
    # And what faces the light is not in its own shadow, except along the way where the light leaves the ball.
    toward = np.array(unit_light.vector) - (0 if distant else points)
    cosine = (oracle.unit(np.broadcast_to(toward, points.shape)) * texels.normal).sum(-1)
    ball = texels.coverage & ~floor
    facing = weights[ball & (cosine > 0.15)]
    assert facing.min() > 0.3 and (facing > 0.99).mean() > 0.99
    assert (weights[ball & (cosine < -0.2)] == 0).all()


@pytest.mark.parametrize("degrees", [0, 30, 60, 80, 87])
@pytest.mark.parametrize("distant", [True, False])
def test_a_plane_and_a_coarse_ball_do_not_shade_themselves_however_the_light_slants(degrees, distant):
    angle = np.deg2rad(degrees)
    direction = np.array([np.sin(angle) * 0.8, np.sin(angle) * 0.6, np.cos(angle)])
    light = Light(tuple(direction)) if distant else Light(tuple(5 * direction), distant=False)
    _, weights = all_weights(oracle.plane(2.0, columns=7, rows=5), light, (64, 64))
    assert (weights == 1).all()
    texels, weights = all_weights(oracle.sphere(1.0, 16, 8), light, (64, 64))
    toward = direction if distant else oracle.unit(5 * direction - texels.position)
    assert (weights[(texels.normal * toward).sum(-1) > 0.02] > 0.5).mean() > 0.995


def test_faces_that_turn_away_lose_weight_over_seven_degrees_and_not_at_once():
    degrees = np.array([-1.0, 0.0, 3.0, 6.0, 9.0])
    expected = [1, 1, 1 - np.sin(np.deg2rad(3)) / 0.12, 1 - np.sin(np.deg2rad(6)) / 0.12, 0]
    for below, wanted in zip(degrees, expected, strict=True):
        angle = np.deg2rad(below)
        _, weights = all_weights(oracle.plane(2.0), Light((np.cos(angle), 0.0, -np.sin(angle))), (16, 16))
        np.testing.assert_allclose(weights, wanted, atol=1e-4)


@pytest.mark.parametrize(("vector", "distant"), [((0.5, -1.0, 0.9), True), ((1.2, -1.6, 0.6), False)])
def test_the_shadows_on_a_monkey_agree_with_rays(vector, distant):
    bpy.ops.mesh.primitive_monkey_add()
    obj = bpy.context.object
    obj.modifiers.new("subdivision", "SUBSURF").levels = 2
    bpy.context.view_layer.update()
    mesh = extract_mesh(obj)
    light = Light(tuple(oracle.unit(np.array(vector)) if distant else vector), distant=distant)
    texels, weights = all_weights(mesh, light, (192, 192))
    tree = BVHTree.FromPolygons(
        mesh.positions.reshape(-1, 3).tolist(), np.arange(3 * len(mesh.positions)).reshape(-1, 3).tolist()
    )
    width = shadows.texel_size(mesh, texels)
    chosen = np.random.default_rng(0).choice(np.flatnonzero(texels.coverage), 2500, replace=False)
    points = texels.position.reshape(-1, 3)[chosen].astype(np.float64)
    faces = texels.face_normal.reshape(-1, 3)[chosen].astype(np.float64)
    toward = np.broadcast_to(light.vector, points.shape) if distant else np.array(light.vector) - points
    facing = (oracle.unit(toward) * faces).sum(-1) > 0.1
    right = oracle.unit(np.cross(faces, (0.3, 0.5, 0.8)))
    beside = [np.zeros(3), right, -right, np.cross(faces, right), -np.cross(faces, right)]
    rays = np.array([cast(tree, points + width * (step + 0.3 * faces), light) for step in beside])
    sure = facing & (rays == rays[0]).all(0)  # where rays two texels apart agree: away from the border
    same = (weights.ravel()[chosen] > 0.5) == rays[0]
    print(f"{same[sure].mean():.4f} of {sure.sum()} texels away from borders, {same[facing].mean():.4f} of all; "
          f"{1 - rays[0][facing].mean():.2f} in shadow")  # fmt: skip
    assert sure.sum() > 600 and 0.05 < 1 - rays[0][facing].mean() < 0.5
    assert same[sure].mean() > 0.99 and same[facing].mean() > 0.97


@pytest.mark.parametrize(("bevel", "cosine"), [(0.0, 0.93), (0.0, 0.3), (0.0, 0.06), (0.03, 0.93), (0.03, 0.15)])
def test_a_plate_shades_the_large_faces_of_a_smooth_box_as_rays_have_it(bevel, cosine):
    bpy.ops.mesh.primitive_cube_add(size=1)
    box = bpy.context.object
    if bevel:
        modifier = box.modifiers.new("bevel", "BEVEL")
        modifier.width, modifier.segments = bevel, 2
        bpy.ops.object.modifier_apply(modifier="bevel")
    bpy.ops.mesh.primitive_cube_add(size=1, location=(0, 0, 0.53), scale=(0.12, 0.5, 0.02))
    box.select_set(True)
    bpy.ops.object.join()
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.uv.smart_project(island_margin=0.02)
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.ops.object.shade_smooth()
    mesh = extract_mesh(bpy.context.object)
    aside = np.sqrt(1 - cosine**2) * oracle.unit(np.array([0.35, 0.1]))
    light = Light((*aside, cosine))
    texels, weights = all_weights(mesh, light, (192, 192))
    top = texels.coverage & (texels.face_normal[..., 2] > 0.9) & (texels.position[..., 2] < 0.501)
    tree = BVHTree.FromPolygons(
        mesh.positions.reshape(-1, 3).tolist(), np.arange(3 * len(mesh.positions)).reshape(-1, 3).tolist()
    )
    seen = cast(tree, texels.position[top].astype(np.float64) + (0, 0, 1e-4), light)
    lit, dark = (weights[top][seen == way] for way in (True, False))
    print(f"{(dark > 0.5).mean():.3f} of {len(dark)} shadowed texels lit, {(lit < 0.5).mean():.3f} of the others dark")
    assert len(dark) > 200 and (dark > 0.5).mean() < 0.05 and (lit < 0.5).mean() < 0.08


def cast(tree, points, light):
    """Return (N,) bool: which points see a light."""
    seen = np.empty(len(points), bool)
    for number, point in enumerate(points):
        toward = Vector(light.vector) if light.distant else Vector(light.vector) - Vector(point)
        seen[number] = (
            tree.ray_cast(Vector(point), toward.normalized(), 1e9 if light.distant else toward.length)[0] is None
        )
    return seen


def taken(mesh, lights, cameras, read):
    """Return a capture of every light from every camera; ``read`` gives an image for (light, camera)."""
    observations = tuple(
        Observation(f"{n} {k}", lambda light=light, k=k: read(light, k), light, k)
        for n, light in enumerate(lights)
        for k in range(len(cameras))
    )
    masks = tuple(np.ones((camera.height, camera.width), bool) for camera in cameras)
    return Capture("test", observations, tuple(cameras), masks)


def test_shadows_are_stack_weights_computed_once_per_light(monkeypatch):
    mesh = ball_over_floor()
    light = Light(tuple(oracle.unit(np.array([0.5, 0.3, 0.8]))))
    brighter = replace(light, intensity=(2.0, 2.0, 2.0))
    cameras = [Camera.from_fov(96, 96, 40, ABOVE), Camera.orthographic(96, 96, 2.4, ABOVE)]
    capture = taken(mesh, [light, brighter], cameras, lambda *_: np.ones((96, 96, 4), np.float32))
    made = []
    draw = shadows.camera_triangles
    monkeypatch.setattr(shadows, "camera_triangles", lambda *given: made.append(1) or draw(*given))
    shaded = domain_from_mesh(capture, mesh, *SIZE)
    assert len(made) == 1
    plain = domain_from_mesh(capture, mesh, *SIZE, shadows=False)
    assert len(made) == 1
    _, weights = all_weights(mesh, light)
    np.testing.assert_allclose(shaded.stack.values[..., 3], plain.stack.values[..., 3] * weights, atol=1e-6)
    np.testing.assert_array_equal(shaded.stack.values[..., :3], plain.stack.values[..., :3])
    hidden = (plain.stack.values[0, ..., 3] > 0) & (shaded.stack.values[0, ..., 3] == 0)
    assert 50 < hidden.sum() < 0.5 * plain.bake.coverage.sum()


def test_shadow_weights_match_cycles_shadows(tmp_path):
    bpy.ops.mesh.primitive_uv_sphere_add(segments=48, ring_count=24, radius=RADIUS, location=BALL)
    for polygon in bpy.context.object.data.polygons:
        polygon.use_smooth = True
    ball = bpy.context.object
    bpy.ops.mesh.primitive_plane_add(size=2)
    floor = bpy.context.object
    for obj, low in ((floor, 0.0), (ball, 0.5)):
        values = np.empty(2 * len(obj.data.loops), np.float32)
        obj.data.uv_layers.active.uv.foreach_get("vector", values)
        values[::2] = values[::2] * 0.5 + low
        obj.data.uv_layers.active.uv.foreach_set("vector", values)
    floor.data.uv_layers.active.name = ball.data.uv_layers.active.name = "UV"
    with bpy.context.temp_override(active_object=floor, selected_editable_objects=[floor, ball]):
        bpy.ops.object.join()
    data = bpy.data.lights.new("lamp", "POINT")
    data.energy, data.shadow_soft_size = 100, 0
    lamp = bpy.data.objects.new("lamp", data)
    lamp.location = place = (0.9, -0.8, 1.4)
    bpy.context.collection.objects.link(lamp)
    image = cycles(tmp_path / "lit.exr", 160)
    light = Light(place, distant=False)
    capture = taken(None, [light], [Camera.orthographic(160, 160, 2.2, ABOVE)], lambda *_: image)
    mesh = extract_mesh(floor)
    domain = domain_from_mesh(capture, mesh, *SIZE)
    plain = domain_from_mesh(capture, mesh, *SIZE, shadows=False)
    toward = oracle.unit(np.array(place) - domain.bake.position)
    seen = (plain.stack.values[0, ..., 3] > 0) & ((toward * domain.bake.face_normal).sum(-1) > 0.1)
    radiance = plain.stack.values[0, ..., 0]
    whole = np.median(radiance[seen & (radiance > 0)])
    dark, lit = seen & (radiance < 1e-4 * whole), seen & (radiance > 0.1 * whole)
    weight = domain.stack.values[0, ..., 3] / np.maximum(plain.stack.values[0, ..., 3], 1e-9)
    assert dark.sum() > 80 and lit.sum() > 1500
    print(f"dark with weight {(weight[dark] > 0.5).mean():.4f}, lit without {(weight[lit] < 0.5).mean():.4f}")
    assert (weight[dark] > 0.5).mean() < 0.01 and (weight[lit] < 0.5).mean() < 0.01


def cycles(path, size):
    """Return (H, W, 4) what Cycles renders of direct light from above, with weight 1."""
    import OpenEXR

    scene = bpy.context.scene
    camera = bpy.data.cameras.new("view")
    camera.type, camera.ortho_scale = "ORTHO", 2.2
    scene.camera = bpy.data.objects.new("view", camera)
    scene.camera.location = (0, 0, 4)
    scene.collection.objects.link(scene.camera)
    settings = scene.render
    settings.engine, settings.filepath = "CYCLES", str(path)
    settings.resolution_x = settings.resolution_y = size
    settings.image_settings.file_format, settings.image_settings.color_depth = "OPEN_EXR", "32"
    scene.cycles.samples, scene.cycles.max_bounces, scene.cycles.use_denoising = 4, 0, False
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BOX", 0.01
    bpy.ops.render.render(write_still=True)
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = file.channels()
        image = np.stack([channels[c].pixels for c in "RGB"], axis=-1)[::-1]
    return np.concatenate([image, np.ones((size, size, 1))], axis=-1).astype(np.float32)


@pytest.mark.parametrize("shape", ["spot", "flat"])
@pytest.mark.parametrize("card", [True, False])
def test_the_beam_of_a_spot_or_flat_light_is_divided_out_of_samples(shape, card):
    camera = Camera.from_fov(96, 96, 36.9, ABOVE)  # 2.7 wide at the plane
    axis = tuple(oracle.unit(np.array([-0.2, 0.1, -1.0])))
    given = {"cone": 35.0} if shape == "spot" else {"cosine": True}
    light = Light((0.5, -0.2, 1.0), distant=False, axis=axis, **given)
    cone = np.cos(np.deg2rad(35))

    def under(points):
        """Return the cosine to the axis and the radiance of a white plane that faces up under an even light."""
        away = points - np.array(light.vector)
        return (oracle.unit(away) * axis).sum(-1), -oracle.unit(away)[..., 2] / (away**2).sum(-1)

    cosine, even = under(camera.points(4.0))
    share = (cosine > cone) * 1.0 if shape == "spot" else np.maximum(cosine, 0)
    image = np.ones((96, 96, 4), np.float32)
    image[..., :3] = (share * even)[..., None]
    capture = taken(None, [light], [camera], lambda *_: image)
    if card:
        domain = build.domain_from_card(replace(capture, card_distance=4.0))
        turned = camera.matrix
    else:
        domain = domain_from_mesh(capture, oracle.plane(2.0), 40, 40, falloff=False, areas=False)
        turned = np.eye(4)
    position = domain.bake.position @ turned[:3, :3].T + turned[:3, 3]
    cosine, radiance = under(position)
    weight = domain.stack.values[0, ..., 3]
    if shape == "spot":
        inside, border = cosine > cone, np.abs(cosine - cone) < 0.03
        sure = inside & ~border
        np.testing.assert_allclose(weight[sure], 1, atol=1e-6)
        assert (weight[~inside & ~border] == 0).all() and (weight == 0).sum() > 300
    else:
        np.testing.assert_allclose(weight, np.where(cosine > 0.05, cosine**2, 0), atol=2e-3)
        sure = cosine > 0.1
    np.testing.assert_allclose(domain.stack.values[0, ..., 0][sure], radiance[sure], rtol=0.02)
    np.testing.assert_allclose(domain.lights[0, 3], 1)


def test_the_beam_is_divided_out_of_samples_in_predicted_shadow_too():
    axis = tuple(oracle.unit(np.array([-0.5, 0.3, -1.0])))
    light = Light((1.2, -0.6, 2.0), distant=False, axis=axis, cosine=32.0)
    image = np.full((96, 96, 4), 0.2, np.float32)
    image[..., 3] = 1
    capture = taken(None, [light], [Camera.from_fov(96, 96, 36.9, ABOVE)], lambda *_: image)
    domain = domain_from_mesh(capture, ball_over_floor(), *SIZE, falloff=False, areas=False)
    radiance, weight = domain.stack.values[0, ..., 0], domain.stack.values[0, ..., 3]
    share = np.maximum((oracle.unit(domain.bake.position - np.array(light.vector)) * axis).sum(-1), 0) ** 32
    seen, wide = radiance > 0, share > 0.05 + 1e-4
    assert (seen & wide & (weight == 0)).sum() > 200 and (seen & (share < 0.05)).sum() > 20
    np.testing.assert_allclose(radiance[seen & wide], 0.2 / share[seen & wide], rtol=1e-4)
    np.testing.assert_allclose(radiance[seen & (share < 0.05 - 1e-4)], 0.2, rtol=1e-6)  # unusable: as photographed
