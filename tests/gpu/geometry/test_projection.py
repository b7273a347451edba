"""Windows of domains, lenses that distort, cameras at several distances, and where each texel is seen from."""

import weakref
from dataclasses import fields, replace

import bpy
import numpy as np
import pytest

from irpso_addon.blender.mesh import extract_mesh
from irpso_addon.capture.camera import Camera
from irpso_addon.capture.types import Capture, Light, Observation
from irpso_addon.core.errors import InputError
from irpso_addon.geometry import build
from irpso_addon.geometry.build import domain_from_card, domain_from_mesh
from irpso_addon.geometry.domain import GeometryBake, subset, tile
from irpso_addon.geometry.surface import bake
from irpso_addon.pipeline.result import _unseen_warnings
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.views.forward import Renderer
from tests.oracles import geometry as oracle
from tests.oracles import reflectance as oracles

ABOVE = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1.0]])
LENS = (-0.28, 0.09, 0.004, -0.003, -0.01)  # a wide lens's barrel, out of true


@pytest.fixture(autouse=True)
def empty_file():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def looking(position, target=(0, 0, 0)):
    back = oracle.unit(np.subtract(position, target).astype(float))
    right = oracle.unit(np.cross((0.1, 0.2, 1.0), back))
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = np.stack([right, np.cross(back, right), back], axis=1), position
    return matrix


def monkey_capture(reads):
    """Return a monkey and a capture of noise from two sides under far and near lights, that counts what is read."""
    bpy.ops.mesh.primitive_monkey_add()
    bpy.context.object.modifiers.new("subdivision", "SUBSURF").levels = 1
    bpy.context.view_layer.update()
    cameras = tuple(Camera.from_fov(150, 130, 40, looking((x, -3, 0.6))) for x in (-3.0, 3.0))
    cameras = (cameras[0], replace(cameras[1], distortion=LENS))
    lights = (Light((0.3, -0.8, 0.52)), Light((1.5, -2, 1), distant=False), Light((-2, -1, -0.5), distant=False))

    def read(number):
        reads.append(number)
        image = np.random.default_rng(number).uniform(0.1, 1, (130, 150, 4)).astype(np.float32)
        image[..., 3] = 1
        return image

    observations = tuple(Observation(f"{n}", lambda n=n: read(n), lights[n % 3], camera=n // 3) for n in range(6))
    return extract_mesh(bpy.context.object), Capture("m", observations, cameras, (np.ones((130, 150), bool),) * 2)


def test_a_window_equals_a_tile_of_the_whole_domain_bit_for_bit():
    mesh, capture = monkey_capture([])  # with shadow maps of more than their least size
    whole = domain_from_mesh(capture, mesh, 180, 240)
    for window in ((27, 81, 61, 113), (100, 120, 60, 15)):
        part, expected = domain_from_mesh(capture, mesh, 180, 240, window=window), tile(whole, *window)
        assert part.origin == expected.origin == window[:2] and part.halo == expected.halo
        np.testing.assert_array_equal(part.stack.values, expected.stack.values)
        for item in fields(GeometryBake):
            np.testing.assert_array_equal(getattr(part.bake, item.name), getattr(expected.bake, item.name))
        assert (part.stack.values[..., 3] > 0).any()
    with pytest.raises(ValueError, match="window 31×57 at .160, 40. leaves the domain of 180×240"):
        domain_from_mesh(capture, mesh, 180, 240, window=(160, 40, 31, 57))


def test_a_window_reads_only_the_images_that_reach_it():
    reads = []
    mesh, capture = monkey_capture(reads)
    whole = domain_from_mesh(capture, mesh, 90, 120)
    assert sorted(reads) == list(range(6))
    # A texel that the first camera sees and the second does not, and one that nothing covers.
    first, second = (whole.stack.values[k : k + 3, ..., 3].max(axis=0) for k in (0, 3))
    y, x = np.argwhere((first > 0.5) & (second == 0))[50]
    reads.clear()
    domain_from_mesh(capture, mesh, 90, 120, window=(int(x), int(y), 1, 1))
    assert sorted(reads) == [0, 1, 2]
    y, x = np.argwhere(~whole.bake.coverage)[0]
    reads.clear()
    empty = domain_from_mesh(capture, mesh, 90, 120, window=(int(x), int(y), 1, 1))
    assert not reads and not empty.stack.values.any()


def test_photographs_that_show_no_texel_are_named_and_not_read():
    reads = []
    mesh, capture = monkey_capture(reads)
    assert domain_from_mesh(capture, mesh, 60, 80).unseen == ()
    away = Camera.from_fov(150, 130, 40, looking((0, -3, 0.6), (0, -9, 0.6)))
    others = tuple(replace(capture.observations[k], camera=2, name=f"away {k}") for k in (0, 4))
    observations = (*capture.observations[:2], *others, *capture.observations[2:])
    reads.clear()
    capture = replace(capture, observations=observations, cameras=(*capture.cameras, away), masks=capture.masks[:1] * 3)
    domain = domain_from_mesh(capture, mesh, 60, 80)
    assert domain.unseen == (2, 3) and sorted(reads) == list(range(6))
    shown = [layer[..., 3].any() for layer in domain.stack.layers()]
    assert [k for k, any_sample in enumerate(shown) if not any_sample] == [2, 3]
    assert subset(domain, [0, 3, 5]).unseen == (1,) and subset(domain, [0, 1]).unseen == ()
    assert _unseen_warnings(domain, capture) == [
        "2 of the 8 photographs show no texel of the mesh and are not used ('away 0', 'away 4'): check the poses of"
        " their cameras, and the mesh's place and unit"
    ]


def test_photographs_whose_light_is_hidden_from_the_mesh_are_named():
    mesh, capture = monkey_capture([])
    assert domain_from_mesh(capture, mesh, 60, 80).shaded == ()
    # Lamps inside their housing, one of each camera.
    place = np.float32([0.0, -4.0, 3.0])
    inside = Light(tuple(place.tolist()), distant=False)
    mesh = replace(mesh, occluders=oracle.sphere(radius=0.2).positions + place)
    observations = tuple(
        replace(one, light=inside) if k in (1, 4) else one for k, one in enumerate(capture.observations)
    )
    hidden = replace(capture, observations=observations)
    domain = domain_from_mesh(hidden, mesh, 60, 80)
    assert domain.shaded == (1, 4) and subset(domain, [0, 4]).shaded == (1,)
    (line,) = _unseen_warnings(domain, hidden)
    assert line.startswith("2 of the 6 photographs are not used, because mesh or occluders hide their light")
    assert domain_from_mesh(hidden, mesh, 60, 80, shadows=False).shaded == ()
    dark = replace(capture, observations=tuple(replace(one, light=inside) for one in capture.observations))
    with pytest.raises(InputError, match="no light reaches what its cameras see of mesh .*[(]--no-shadows[)]"):
        domain_from_mesh(dark, mesh, 60, 80)


def smooth(x, y):
    return 0.5 + 0.2 * np.sin(3 * x + y) + 0.2 * np.cos(2 * y - x)


def test_sampling_follows_lens_distortion():
    camera = Camera(160, 120, (120.0, 124.0), (83.0, 57.0), looking((0.5, -1.0, 2.2)), True, LENS)
    rays = camera.points(1.0) - camera.position
    hit = camera.position + rays * (-camera.position[2] / rays[..., 2:])
    image = np.ones((120, 160, 4), np.float32)
    image[..., :3] = smooth(hit[..., 0], hit[..., 1])[..., None]
    capture = Capture(
        "lens", (Observation("a", lambda: image, Light((0, 0, 1))),), (camera,), (np.ones((120, 160), bool),)
    )
    mesh = oracle.plane(12.0, columns=3, rows=3)
    domain = domain_from_mesh(capture, mesh, 200, 200, areas=False)
    weight = domain.stack.values[0, ..., 3] > 0
    position = domain.bake.position[weight]
    error = np.abs(domain.stack.values[0, ..., 0][weight] - smooth(position[:, 0], position[:, 1]))
    straight = replace(capture, cameras=(replace(camera, distortion=()),))
    blind = domain_from_mesh(straight, mesh, 200, 200, areas=False)
    seen = blind.stack.values[0, ..., 3] > 0
    position = blind.bake.position[seen]
    before = np.abs(blind.stack.values[0, ..., 0][seen] - smooth(position[:, 0], position[:, 1]))
    # Between pixels a quarter of a spacing's square times the second derivative, 13 · 0.2; a pixel is 0.02 to 0.05.
    assert error.max() < 2e-3 and before.mean() > 20 * error.mean()
    # All that the lens shows of the plane is read: as many texels as have a place in the image.
    place, depth = camera.project(domain.bake.position.astype(float))
    cosine = oracle.unit(camera.position - domain.bake.position)[..., 2]
    inside = ((place > 0.6) & (place < [159.4, 119.4])).all(-1) & (cosine > 0.12) & (depth > 0)
    assert inside.sum() > 2000 and weight[inside].mean() > 0.995
    assert not (weight & ~((place >= 0.49) & (place <= [159.51, 119.51])).all(-1)).any()


def test_occlusion_follows_lens_distortion():
    mesh = oracle.joined(oracle.plane(1.0, z=0.5, u_span=(0, 0.4)), oracle.plane(3.0, u_span=(0.4, 1.0)))
    camera = Camera(200, 200, (160.0, 160.0), (100.0, 100.0), ABOVE, True, (-0.35, 0.12))
    image = np.ones((200, 200, 4), np.float32)
    capture = Capture("l", (Observation("a", lambda: image, Light((0, 0, 1))),), (camera,), (image[..., 3] > 0,))
    domain = domain_from_mesh(capture, mesh, 120, 90, shadows=False)
    position, seen = domain.bake.position, domain.stack.values[0, ..., 3] > 0
    # The way from the camera at height 4 passes the plate at height 0.5.
    reach = np.abs(position[..., :2]).max(-1) * np.where(position[..., 2] > 0.25, 1, 3.5 / 4)
    floor, pixel = domain.bake.coverage & (position[..., 2] < 0.25), 4 / 160
    texel = 3.0 / 72
    assert not seen[floor & (reach < 0.5)].any()
    assert seen[floor & (reach > 0.5 + 2 * pixel + texel) & (reach < 1.2)].all()
    assert seen[domain.bake.coverage & ~floor & (reach < 0.5 - 2 * pixel)].all()


def test_lines_of_sight_of_a_card_follow_the_lens():
    camera = Camera(40, 30, (35.0, 35.0), (20.0, 15.0), looking((1, 2, 3)), True, LENS)
    image = np.ones((30, 40, 4), np.float32)
    shots = (Observation("a", lambda: image, Light((0, 0, 1))),)
    domain = domain_from_card(Capture("c", shots, (camera,), (image[..., 3] > 0,), card_distance=2.0))
    place, _ = replace(camera, matrix=np.eye(4)).project(domain.bake.position.astype(float))
    x, y = np.meshgrid(np.arange(40) + 0.5, np.arange(30) + 0.5)
    np.testing.assert_allclose(place, np.stack([x, y], axis=-1), atol=1e-4)
    np.testing.assert_allclose(domain.bake.position[..., 2], -2, atol=1e-6)
    np.testing.assert_array_equal(domain.views, [[0, 0, 0, 1]])


def test_view_directions_point_to_the_camera():
    mesh = oracle.sphere(1.0, 32, 16)
    cameras = [
        Camera.from_fov(20, 20, 60, looking((1.2, -1.0, 0.8))),
        Camera.orthographic(20, 20, 3, looking((2, 2, 1))),
    ]
    texels = bake.bake_uv(mesh, 48, 24)
    values = {"base_color": (0.4, 0.3, 0.2), "normal": (0, 0, 1), "r1": 0.2, "r2": 0.5, "w": 0.6}
    light = oracle.unit(np.array([1.0, -0.2, 0.9]))
    maps = {name: np.tile(np.float32(value), (24, 48, 1)) for name, value in values.items()}
    views = np.float32([camera.view for camera in cameras])
    model = load_model("cook_torrance_two_lobe")
    renderer = Renderer(texels, model, maps, np.float32([[*light, 0]] * 2), np.ones((2, 3), np.float32), views)
    try:
        for number, camera in enumerate(cameras):
            rendered = renderer.render(number)
            toward = camera.position - texels.position if camera.perspective else camera.backward
            view = oracle.unit(np.broadcast_to(toward, texels.position.shape).astype(np.float64))
            normal = texels.normal.astype(np.float64)
            both = texels.coverage & ((normal @ light) > 0.05) & ((normal * view).sum(-1) > 0.05)
            expected = oracles.cook_torrance_two_lobe({**values, "normal": normal}, light, view)
            np.testing.assert_allclose(rendered[both][:, :3], expected[both], rtol=2e-4, atol=1e-5)
            assert both.sum() > 100
            if number == 0:  # one direction for all would be far off
                middle = oracle.unit(camera.position)
                one = oracles.cook_torrance_two_lobe({**values, "normal": normal}, light, middle)
                assert np.abs(one - expected)[both].max() > 0.05
    finally:
        renderer.close()


def test_a_cameras_cached_data_is_freed_after_its_last_image(monkeypatch):
    alive, most = weakref.WeakSet(), []

    class Counted(build.Projector):
        def __init__(self, *args):
            super().__init__(*args)
            alive.add(self)
            most.append(len(alive))

    monkeypatch.setattr(build, "Projector", Counted)
    mesh, capture = monkey_capture([])
    domain_from_mesh(capture, mesh, 60, 80)
    assert most == [1, 2]  # one after the other: under the same lights both are needed
    own = tuple(
        replace(o, light=replace(o.light, vector=tuple(np.add(o.light.vector, 0.1 * o.camera).tolist())))
        for o in capture.observations
    )
    most.clear()
    domain_from_mesh(replace(capture, observations=own), mesh, 60, 80)
    assert most == [1, 1] and not alive
