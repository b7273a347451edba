"""Relief on meshes, and relief displacing a card in Cycles."""

import bpy
import numpy as np
import pytest

from irpso_addon.blender.materials.margins import blender_maps
from irpso_addon.blender.materials.material import apply_material, build_material, card_object
from irpso_addon.capture.camera import Camera
from irpso_addon.geometry.relief import relief
from irpso_addon.geometry.relief.height import Height
from irpso_addon.geometry.surface import bake
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.maps import Maps
from tests.builders import seams
from tests.builders.command_line import angle
from tests.builders.domains import unit
from tests.oracles import geometry as geometry_oracle
from tests.oracles.cycles_passes import normals_of, rendered_passes

SIZE = 96


def test_the_relief_of_a_ball_is_in_world_units():
    mesh = geometry_oracle.sphere(radius=2.0, columns=96, rows=64)
    texels = bake.bake_uv(mesh, 192, 128)
    step = np.float64([np.pi * 2 / 192, np.pi / 128])

    def detail(place):
        x, y, z = np.moveaxis(np.asarray(place, np.float64), -1, 0)
        return 0.02 * np.sin(4 * x + y) * np.cos(3 * z)

    # The slope along tangent and bitangent, by differences over space; the ball's own radius takes the normal's part.
    at = unit(texels.position.astype(np.float64))
    axes, h = texels.frames(), 1e-4
    slope = [
        (detail(2 * unit(at + h * axes[..., k, :])) - detail(2 * unit(at - h * axes[..., k, :]))) / (4 * h)
        for k in (0, 1)
    ]
    normals = unit(np.stack([-slope[0], -slope[1], np.ones_like(slope[0])], axis=-1))
    inner = texels.coverage & (np.abs(texels.position[..., 2]) < 1.8)  # at a pole a texel has no width
    found = relief.mesh_height(mesh, texels, normals, inner)
    truth = detail(texels.position)
    error = (found.values - truth)[inner]
    error -= error.mean()
    print(f"\nball: off by {np.abs(error).max():.5f} of {np.ptp(truth[inner]):.4f}, {found.steps} steps, step {step}")
    assert found.unit == "world" and np.abs(error).max() < 0.02 * np.ptp(truth[inner])


def test_texel_steps_follow_the_positions():
    mesh = geometry_oracle.sphere(columns=12, rows=8)
    texels = bake.bake_uv(mesh, 64, 48)
    along, torn = relief.steps_along(mesh, texels)
    same = (texels.triangle[:, 1:] == texels.triangle[:, :-1]) & texels.coverage[:, 1:]
    difference = (texels.position[:, 1:] - texels.position[:, :-1])[same].astype(np.float64)
    frames = texels.frames()[:, :-1][same]
    expected = np.einsum("nij,nj->ni", frames[:, :2], difference)
    np.testing.assert_allclose(along[:, :-1][same][:, 0], expected, atol=1e-5)
    assert not torn[:, :-1, 0][texels.coverage[:, :-1] & texels.coverage[:, 1:]].any()


def bump(x, y):
    """Return height and normals of a smooth bump on a card one unit wide."""
    z = 0.08 * np.exp(-((x - 0.05) ** 2 + (y + 0.03) ** 2) / 0.03)
    return z, unit(np.stack([2 * (x - 0.05) / 0.03 * z, 2 * (y + 0.03) / 0.03 * z, np.ones_like(z)], axis=-1))


def look_from_above(width):
    """Add a camera five units above the origin that sees so much."""
    data = bpy.data.cameras.new("view")
    data.type, data.ortho_scale = "ORTHO", width
    view = bpy.data.objects.new("view", data)
    view.location = (0, 0, 5)
    bpy.context.scene.collection.objects.link(view)
    bpy.context.scene.camera = view


@pytest.fixture(scope="module")
def card(tmp_path_factory):
    """A card with the recovered relief of a bump in its material, seen from above."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    centres = (np.arange(SIZE) + 0.5) / SIZE - 0.5
    z, normals = bump(*np.meshgrid(centres, centres))
    covered = np.ones((SIZE, SIZE), bool)
    height = relief.card_height(Camera.orthographic(SIZE, SIZE, 7.0), normals, covered)
    values = {"base_color": np.full((SIZE, SIZE, 3), 0.5, np.float32), "normal": normals.astype(np.float32)}
    material = build_material(Maps(load_model("lambert"), values, covered), "bump", height=height)
    obj = card_object("bump", SIZE, SIZE, displaced=True)
    apply_material(obj, material)
    obj.scale = (2, 2, 2)  # the relief grows with its card
    look_from_above(2.0)
    return material, z, normals, tmp_path_factory.mktemp("height")


def passes(path):
    """Return the depth (H, W) and normal (H, W, 3) passes of Cycles, row 0 at the bottom."""
    channels = rendered_passes(path, SIZE)
    depth = next(pixels for name, pixels in channels.items() if name.startswith("ViewLayer.Depth"))
    return depth, normals_of(channels)


INNER = (slice(4, -4), slice(4, -4))


def test_the_displaced_card_has_the_height_of_the_bump_and_the_normal_map_counts_once(card):
    material, z, normals, folder = card
    assert material.displacement_method == "BOTH"
    depth, normal = passes(folder / "both.exr")
    found = (5 - depth) / 2
    error = (found - found.mean() - z + z.mean())[INNER]
    off = angle(unit(normal), normals)[INNER]
    print(f"\nheight off by {np.abs(error).max():.5f} of {np.ptp(z):.3f}; normals 99 % {np.percentile(off, 99):.3f}°")
    assert np.abs(error).max() < 0.005 * np.ptp(z) and np.percentile(off, 99) < 0.1


def test_the_shape_alone_has_the_recovered_normals(card):
    material, _, normals, folder = card
    surface = material.node_tree.nodes["IRPSO surface"].inputs["Normal"]
    link = surface.links[0]
    source = link.from_socket
    material.node_tree.links.remove(link)
    material.displacement_method = "DISPLACEMENT"
    _, normal = passes(folder / "shape.exr")
    material.displacement_method = "BOTH"
    material.node_tree.links.new(source, surface)
    off = angle(unit(normal), normals)[INNER]
    print(f"\nnormals of the shape: median {np.median(off):.3f}°, 99 % {np.percentile(off, 99):.3f}°")
    assert np.median(off) < 0.1 and np.percentile(off, 99) < 1


def test_rebuilding_without_height_removes_the_displacement(card):
    material, _, normals, _ = card
    values = {"base_color": np.full((SIZE, SIZE, 3), 0.5, np.float32), "normal": normals.astype(np.float32)}
    again = build_material(Maps(load_model("lambert"), values, np.ones((SIZE, SIZE), bool)), "bump")
    obj = card_object("bump", SIZE, SIZE)
    assert not obj.modifiers
    assert again == material and "IRPSO displacement" not in material.node_tree.nodes
    assert not material.node_tree.nodes["IRPSO output"].inputs["Displacement"].is_linked


def test_the_relief_of_a_mesh_with_unequal_scale_has_world_height(tmp_path):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    centres = (np.arange(SIZE) + 0.5) / SIZE - 0.5
    z, normals = bump(*np.meshgrid(centres, centres))
    covered = np.ones((SIZE, SIZE), bool)
    values = {"base_color": np.full((SIZE, SIZE, 3), 0.5, np.float32), "normal": normals.astype(np.float32)}
    height = Height(z.astype(np.float32), covered, "world")
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=128, y_subdivisions=128, size=1, calc_uvs=True)
    obj = bpy.context.object
    obj.scale = (2, 2, 0.25)
    obj.data.polygons.foreach_set("use_smooth", np.ones(len(obj.data.polygons), bool))
    apply_material(obj, build_material(Maps(load_model("lambert"), values, covered), "sheet", height=height))
    look_from_above(2.0)
    depth, _ = passes(tmp_path / "world.exr")
    error = np.abs(5 - depth - z)[INNER]
    assert error.max() < 0.005 * np.ptp(z)


def test_the_relief_of_a_card_does_not_wrap_around(tmp_path):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    covered = np.ones((SIZE, SIZE), bool)
    slope = np.broadcast_to(np.linspace(0, 24, SIZE, dtype=np.float32), (SIZE, SIZE))
    flat = np.broadcast_to(np.float32([0, 0, 1]), (SIZE, SIZE, 3))
    maps = Maps(
        load_model("lambert"), {"base_color": np.full((SIZE, SIZE, 3), 0.5, np.float32), "normal": flat}, covered
    )
    obj = card_object("slope", SIZE, SIZE, displaced=True)
    apply_material(obj, build_material(maps, "slope", height=Height(slope, covered, "texels")))
    look_from_above(1.0)
    depth, _ = passes(tmp_path / "slope.exr")
    assert np.abs(5 - depth - slope / SIZE)[4:-4].max() < 0.5 / SIZE


def test_the_displacement_of_a_mesh_is_whole_at_its_seams():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    surface, model = seams.sheet("as it is"), load_model("lambert")
    domain = surface.domain()
    covered, slope = domain.bake.coverage, 0.3 * domain.bake.frames()[..., :2, 1].astype(np.float64)  # along world y
    normals = unit(np.concatenate([-slope, np.ones_like(slope[..., :1])], axis=-1))
    height = relief.mesh_height(surface.mesh, bake.bake_uv(surface.mesh, *domain.shape[::-1]), normals, covered)
    maps = Maps(model, {p.name: np.zeros((*domain.shape, 3), np.float32) for p in model.parameters}, covered)
    found = blender_maps(maps, surface.mesh, domain.bake, domain.seams)
    build_material(found, "sheet", height=height)
    image = bpy.data.images["IRPSO sheet height"]
    shown = np.array(image.pixels).reshape(*domain.shape, -1)[..., 0]
    rows, columns = np.nonzero(found.margin & np.roll(covered, 1, axis=1))
    assert len(rows) > 10
    np.testing.assert_allclose(shown[rows, columns], height.values[rows, columns - 1], atol=1e-5)
