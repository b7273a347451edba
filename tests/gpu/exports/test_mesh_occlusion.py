"""The occlusion of meshes, against form factors: spheres, walls and planes in closed form."""

import os
from dataclasses import replace

import bpy
import numpy as np
import pytest
from mathutils import Matrix, Vector

from irpso_addon.blender.materials.result_blend import save_blend
from irpso_addon.blender.mesh import extract_mesh
from irpso_addon.blender.occlusion import mesh_open_sky
from irpso_addon.blender.operators import quiet_operator
from irpso_addon.core.errors import InputError
from irpso_addon.core.udim import tile_part
from irpso_addon.exports.gltf import write_gltf
from irpso_addon.exports.result import Result
from irpso_addon.exports.textures import write_textures
from irpso_addon.geometry.surface.bake import bake_uv
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.maps import Maps
from irpso_addon.results.write import write_maps
from tests.builders.cavity import cavity_mesh
from tests.builders.command_line import run_cli
from tests.builders.exports import image_of, on_a_sheet, picture, read_glb
from tests.oracles.geometry import joined, mesh_from_grid, plane, sphere

RAYS = 256
NOISE = 0.03  # four deviations of a texel at 256 rays


@pytest.fixture(autouse=True)
def empty_file():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def maps_of(mesh, texels=48, normal=(0, 0, 1), covered=None):
    width, height = mesh.domain_size(texels, texels)
    normals = np.broadcast_to(np.float32(normal), (height, width, 3))
    covered = bake_uv(mesh, width, height, True).coverage if covered is None else covered
    return Maps(load_model("lambert"), {"normal": normals}, covered, tiles=mesh.tiles)


def counts():
    kinds = ("objects", "meshes", "materials", "scenes", "worlds", "node_groups")
    return [len(getattr(bpy.data, kind)) for kind in kinds]


@pytest.mark.parametrize("opening", [0.0, -0.5])
def test_every_place_in_a_hollow_sphere_sees_the_share_of_it_that_is_open(opening):
    """Form factors in a sphere are areas over that of the sphere: the missing cap has (1 + opening) / 2 of it."""
    before = counts()
    mesh = cavity_mesh(opening)
    maps = maps_of(mesh)
    found = mesh_open_sky(mesh, maps, RAYS)[maps.solved]
    wanted = (1 + opening) / 2
    assert found.mean() == pytest.approx(wanted, abs=0.002)
    np.testing.assert_allclose(found, wanted, atol=NOISE + 0.02)  # facets of 3.75°
    assert counts() == before


def test_the_foot_of_a_wall_loses_the_sky_behind_it():
    """A wall of height h, long, hides (1 − d / √(d² + h²)) / 2 at distance d (Siegel & Howell, strip at a right angle).

    The floor's texels lie in the left half of the UV square, the wall's in the right one.
    """
    tall, length = 1.0, 400.0

    def wall(u, v):
        return np.stack([np.ones_like(u), length * (u - 0.5), tall * v], -1)

    def floor(u, v):
        return np.stack([2 * u - 1, 2 * v - 1, np.zeros_like(u)], -1)

    def face(u, v):
        return np.zeros((*u.shape, 3)) + (-1, 0, 0)

    def ground(u, v):
        return np.zeros((*u.shape, 3)) + (0, 0, 1)

    mesh = joined(
        mesh_from_grid(floor, ground, 8, 8, lambda u, v: (0.45 * u, v)),
        mesh_from_grid(wall, face, 8, 8, lambda u, v: (0.55 + 0.45 * u, v)),
    )
    maps = maps_of(mesh, 64)
    found = mesh_open_sky(mesh, maps, RAYS)
    columns = np.arange(28)  # of the floor, less its last texels, where the columns are narrow against the slope
    distance = 1 - (2 * ((columns + 0.5) / 64 / 0.45) - 1)
    wanted = 1 - (1 - distance / np.hypot(distance, tall)) / 2
    np.testing.assert_allclose(found[8:56, columns].mean(axis=0), wanted, atol=0.006)
    assert wanted.min() < 0.55 and wanted.max() > 0.9


@pytest.mark.parametrize("degrees", [20, 50])
def test_a_recovered_normal_that_leans_loses_the_sky_below_the_face(degrees):
    """About a normal that leans by t from a plane, (1 + cos t) / 2 of the cosine-weighted sky is above the plane."""
    angle = np.radians(degrees)
    mesh = plane(2.0)
    found = mesh_open_sky(mesh, maps_of(mesh, 24, (np.sin(angle), 0, np.cos(angle))), RAYS)
    assert found.mean() == pytest.approx((1 + np.cos(angle)) / 2, abs=0.003)


def test_a_leaning_normal_sees_what_it_leans_toward():
    """In a half sphere, tangents of its UV square run around: rays about the leaning normal in float64."""
    mesh, angle = cavity_mesh(0.0), np.radians(40)
    maps = maps_of(mesh, 48, (0, np.sin(angle), np.cos(angle)))  # up the UV square: toward the pole, away from the rim
    found = mesh_open_sky(mesh, maps, RAYS)
    texels = bake_uv(mesh, 48, 48, True)
    row = 12
    place, frame = texels.position[row, 5].astype(np.float64), texels.frames((row, 5))
    place /= np.linalg.norm(place)
    normal = np.sin(angle) * frame[1] + np.cos(angle) * frame[2]
    rays = np.random.default_rng(1).normal(size=(400000, 3))
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True) + normal  # cosine-weighted (Lambert)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    inward = -(rays @ place)  # half the way to where the ray meets the sphere again
    free = (inward > 0) & (place[2] + 2 * inward * rays[:, 2] < 0)
    assert found[row].mean() == pytest.approx(free.mean(), abs=0.006)
    assert abs(free.mean() - 0.5) > 0.05


def test_an_occluder_hides_its_part_of_the_sky_on_an_object_that_is_mirrored_and_stretched():
    """A ball straight above a place hides sin²(its half angle)."""
    data = bpy.data.meshes.new("sheet")
    data.from_pydata([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [], [(0, 1, 2, 3)])
    data.uv_layers.new(name="UVMap").uv.foreach_set("vector", (0, 0, 1, 0, 1, 1, 0, 1))
    obj = bpy.data.objects.new("sheet", data)
    obj.matrix_world = Matrix.Translation((5, 6, 7)) @ Matrix.Diagonal((-1.5, 0.5, 2, 1))
    bpy.context.scene.collection.objects.link(obj)
    flat, ball = extract_mesh(obj), sphere(0.5, centre=(5, 6, 8)).positions
    found = mesh_open_sky(replace(flat, occluders=ball), maps_of(flat, 63), 1024)
    assert found[31, 31] == pytest.approx(1 - 0.25, abs=0.02)
    assert mesh_open_sky(flat, maps_of(flat, 16), 16).min() == 1


def test_slots_that_are_not_recovered_hide_the_sky_and_get_no_texels():
    flat, ball = plane(2.0), sphere(0.5, centre=(0, 0, 1.0))
    mesh = joined(flat, ball)  # over the same texels
    mesh = replace(mesh, solved=np.arange(len(mesh.positions)) < len(flat.positions))
    found = mesh_open_sky(mesh, maps_of(mesh, 63), 1024)
    assert found[31, 31] == pytest.approx(1 - 0.25, abs=0.02) and found[2, 2] > 0.93


def test_past_a_seam_lies_what_is_across_it():
    """A strip is cut in two islands, which lie apart."""
    half = mesh_from_grid(
        lambda u, v: np.stack([u, v - 0.5, 0 * u], -1), lambda u, v: np.zeros((*u.shape, 3)) + (0, 0, 1), 4, 4,
        lambda u, v: (0.05 + 0.3 * u, 0.1 + 0.8 * v),
    )  # fmt: skip
    rest = mesh_from_grid(
        lambda u, v: np.stack([1 + u, v - 0.5, 0 * u], -1), lambda u, v: np.zeros((*u.shape, 3)) + (0, 0, 1), 4, 4,
        lambda u, v: (0.6 + 0.3 * u, 0.1 + 0.8 * v),
    )  # fmt: skip
    mesh = replace(joined(half, rest), occluders=sphere(0.3, centre=(1.1, 0, 0.4)).positions)
    maps = maps_of(mesh, 128)
    found = mesh_open_sky(mesh, maps, RAYS)
    edge, start = round(0.35 * 128), round(0.6 * 128)
    rows = slice(20, 108)
    past, across = found[rows, edge + 1 : edge + 5], found[rows, start + 1 : start + 5]
    assert np.abs(past - across).mean() < 0.03 < np.abs(across - found[rows, edge - 2][:, None]).mean()


def test_the_margin_around_a_round_island_is_as_open_as_the_island():
    """A half sphere sees half of the sky everywhere. Unwrapped as a disc, it has a rim that runs across texels."""
    mesh = cavity_mesh(0.0)
    angle, radius = 2 * np.pi * mesh.uvs[..., 0], 0.4 * (1 - 0.98 * mesh.uvs[..., 1])
    disc = 0.5 + radius[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    mesh = replace(mesh, uvs=disc.astype(np.float32))
    maps = maps_of(mesh, 80)
    assert 0.4 < maps.solved.mean() < 0.6
    np.testing.assert_allclose(mesh_open_sky(mesh, maps, RAYS), 0.5, atol=NOISE + 0.02)


def test_maps_of_another_mesh_are_refused():
    mesh = plane(2.0, u_span=(0.0, 0.5))
    with pytest.raises(InputError, match=r"'UVMap' of 'test' does not cover"):
        mesh_open_sky(mesh, maps_of(mesh, 64, covered=np.ones((64, 64), bool)), 4)


def test_the_command_bakes_the_object_of_the_result(tmp_path):
    result, obj = on_a_sheet("principled", texels=64)
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.4, location=obj.matrix_world @ Vector((0, 0, 1.4)))
    bpy.context.object.name = "ball"
    write_maps(result.maps, tmp_path / "leaf", {"model": "principled", "settings": {"object": "sheet", "slots": None}})
    save_blend(tmp_path / "leaf" / "material.blend")
    shown = []
    for number, more in enumerate(((), ("--occluder", "ball"))):
        out = tmp_path / f"set{number}"
        code, _, err = run_cli(
            "export",
            tmp_path / "leaf",
            "--format",
            "textures",
            "--occlusion",
            "--rays",
            64,
            *more,
            "-o",
            out,
            "--quiet",
        )
        assert code == 0, err
        shown.append(picture(out / "leaf_AO.png")[..., 0][result.maps.solved])
    assert 0.8 < shown[0].mean() < 0.99 and shown[0].min() > 0.4  # its normals lean by up to 30°
    assert shown[1].mean() < shown[0].mean() - 0.02
    code, _, err = run_cli(
        "export",
        tmp_path / "leaf",
        "--format",
        "gltf",
        "--occlusion",
        "--rays",
        4,
        "-o",
        tmp_path / "leaf.glb",
        "--quiet",
    )
    assert code == 0, err
    assert "occlusionTexture" in read_glb(tmp_path / "leaf.glb")[0]["materials"][0]


def test_a_quiet_command_of_a_mesh_writes_nothing_to_the_terminal(tmp_path, capfd):
    """Blender writes from C: what it reads, renders and bakes, and how long that took."""
    settings = {"model": "principled", "settings": {"object": "sheet", "slots": None}}
    write_maps(on_a_sheet("principled", texels=16)[0].maps, tmp_path / "leaf", settings)
    save_blend(tmp_path / "leaf" / "material.blend")
    capfd.readouterr()
    for number, words in enumerate((("textures", "--occlusion", "--rays", 1), ("gltf",), ("turntable",), ("asset",))):
        code, said, error = run_cli(
            "export", tmp_path / "leaf", "--format", *words, "-o", tmp_path / f"out{number}", "--quiet"
        )
        assert (code, said, error) == (0, "", "")
        assert tuple(capfd.readouterr()) == ("", ""), words


def test_errors_that_blender_only_prints_stay_visible(capfd):
    line = "00:56.960  bpy.rna          | ERROR Python script error in CYCLES.render"
    with quiet_operator():
        os.write(1, f"Read blend\n{line}\n".encode())
    assert tuple(capfd.readouterr()) == ("", f"{line}\n")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--format", "textures", "--rays", 4), "--rays: applies to a mesh's occlusion"),
        (("--format", "ptm", "--occlusion"), "--format ptm has no occlusion"),
        (("--format", "textures", "--occlusion", "--rays", 0), "--rays 0"),
        (("--format", "textures", "--occlusion"), "recover with --height"),
    ],
)
def test_what_has_no_occlusion_is_refused_and_nothing_is_written(options, words, tmp_path):
    write_maps(on_a_sheet("principled", texels=16)[0].maps, tmp_path / "leaf", {"model": "principled", "settings": {}})
    code, _, err = run_cli("export", tmp_path / "leaf", *options, "-o", tmp_path / "set")
    assert code == 2 and words in err and not (tmp_path / "set").exists()


def test_texture_sets_and_gltf_have_a_meshs_occlusion_in_every_tile(tmp_path):
    result, obj = on_a_sheet("principled", texels=32)
    sky = np.random.default_rng(0).random((32, 32)).astype(np.float32)
    one = replace(result, card=False, baked_sky=sky)
    write_gltf(one, tmp_path / "leaf.glb", obj)
    table, binary = read_glb(tmp_path / "leaf.glb")
    red = image_of(table, binary, table["materials"][0]["occlusionTexture"], tmp_path)[..., 0]
    inside = result.maps.solved
    np.testing.assert_allclose(red[inside], sky[inside], atol=0.51 / 255)
    wide = Maps(
        result.maps.model, {n: np.concatenate([v, v], axis=1) for n, v in result.maps.values.items()},
        np.concatenate([inside, inside], axis=1), tiles=(1001, 1002),
    )  # fmt: skip
    both = np.concatenate([sky, 1 - sky], axis=1)
    write_textures(Result("leaf", wide, card=False, baked_sky=both), tmp_path / "set")
    for index, number in enumerate(wide.tiles):
        part = tile_part(both, index, 2)[inside]
        for name, channel in (("AO", 0), ("ORM", 0)):
            shown = picture(tmp_path / "set" / f"leaf_{name}.{number}.png")[..., channel][inside]
            np.testing.assert_allclose(shown, part, atol=0.51 / 255)
