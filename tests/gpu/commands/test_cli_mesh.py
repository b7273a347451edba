"""From maps to camera images and back: ``render``, then ``recover --blend``; and what Cycles makes of the result."""

import json
import re
import shutil
from types import SimpleNamespace

import bpy
import numpy as np
import OpenEXR
import pytest
from mathutils import Vector

from irpso_addon.blender.scenes.light_units import sun_strength
from irpso_addon.capture.images.exr import write_exr
from irpso_addon.pipeline import result
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.read import read_maps
from tests.builders import command_line as cli_maker
from tests.builders.command_line import angle, read_map, run_cli

TEXELS = 48
PIXELS = 112
CAMERAS = {"left": (-2.2, -4.0, 1.2), "right": (2.4, -3.6, -0.8)}
CARD = (24, 36)
RANGES = {
    "lambert": {},
    "principled": {"roughness": (0.3, 0.6), "specular": (0.3, 0.8)},
    "cook_torrance_two_lobe": {"r1": (0.15, 0.25), "r2": (0.4, 0.6), "w": (0.4, 0.7)},
    "principled_two_lobe": {"r1": (0.4, 0.5), "r2": (0.6, 0.8), "w": (0.4, 0.7)},
}


def sphere(bpy):
    """A smooth ball with Blender's own UVs, which fill the square, and two cameras."""
    bpy.ops.mesh.primitive_uv_sphere_add(segments=48, ring_count=32)
    ball = bpy.context.object
    ball.name = "Ball"
    for polygon in ball.data.polygons:
        polygon.use_smooth = True
    for name, place in CAMERAS.items():
        cli_maker.add_camera(bpy, name, place, lens=70)


def mesh_lights():
    """24 directions around the way that the cameras look from."""
    middle = Vector(np.mean([np.array(p) / np.linalg.norm(p) for p in CAMERAS.values()], axis=0).tolist())
    turn = np.array(middle.to_track_quat("Z", "Y").to_matrix())
    return cli_maker.dome_lights(24, widest=70) @ turn.T


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    """The folder of a capture rendered from known maps, and the maps."""
    folder = tmp_path_factory.mktemp("ball")
    cli_maker.save_scene(folder / "scene.blend", sphere)
    values = cli_maker.smooth_maps((TEXELS, TEXELS), {"roughness": (0.3, 0.5)}, seed=4, tilt=15)
    parts = {
        "base_color": {c: values["base_color"][..., i] for i, c in enumerate("RGB")},
        "normal": {c: values["normal"][..., i] for i, c in enumerate("RGB")},
        "roughness": {"Y": values["roughness"]},
    }
    write_exr(folder / "known.exr", {n: {c: v.astype(np.float32) for c, v in p.items()} for n, p in parts.items()})
    np.savetxt(folder / "lights.txt", mesh_lights())
    code, out, err = run_cli(
        "render", folder / "known.exr", "--blend", folder / "scene.blend", "--camera", "left", "--camera", "right",
        "--size", f"{PIXELS}x{PIXELS}", "--lights", folder / "lights.txt", "-o", folder / "capture", "--json",
    )  # fmt: skip
    assert (code, err) == (0, "") and json.loads(out.splitlines()[-1])["images"] == 48
    recover_ball(folder, "out", "--fixed", "specular=0.5", "--iterations", 600)
    return folder, values


def recover_ball(folder, out, *options):
    code, _, err = run_cli(
        "recover", folder / "capture", "--blend", folder / "scene.blend", "--object", "Ball", "--resolution", TEXELS,
        "-o", folder / out, "--quiet", *options,
    )  # fmt: skip
    assert (code, err) == (0, "")


def print_errors(errors):
    for name, (error, unit) in errors.items():
        print(
            f"{name}: mean {error.mean():.3f}{unit}, median {np.median(error):.3f}, 99 % {np.percentile(error, 99):.2f}"
        )


def seen_texels(folder):
    with OpenEXR.File(str(folder / "maps.exr"), separate_channels=True) as file:
        (coverage,) = [part.channels["Y"].pixels for part in file.parts if part.name() == "coverage"]
    return coverage[::-1] > 0


def test_maps_of_a_mesh_are_recovered_where_they_are_seen(ball):
    folder, values = ball
    found = read_maps(folder / "out", load_model("principled"))
    seen = seen_texels(folder / "out")
    normal = angle(found["normal"], values["normal"])[seen]
    color = 100 * np.abs(found["base_color"] - values["base_color"]).mean(axis=-1)[seen]
    rough = 100 * np.abs(found["roughness"][..., 0] - values["roughness"])[seen]
    print(f"\n{seen.mean():.0%} of the texels seen")
    print_errors({"normal": (normal, "°"), "base_color": (color, " %"), "roughness": (rough, " %")})
    assert 0.35 < seen.mean() < 0.7
    report = json.loads((folder / "out" / "report.json").read_text(encoding="utf-8"))
    assert report["texels"] == seen.sum() and report["unseen_texels"] == seen.size - seen.sum()
    # Many texels show no highlight in any image, and there nothing but the albedo tells of the roughness.
    assert normal.mean() < 0.4 and color.mean() < 2.0 and np.median(rough) < 12


def test_maps_with_holes_render_black_there_with_a_warning(ball, tmp_path):
    folder, values = ball
    normal = np.where(np.arange(TEXELS)[:, None, None] < TEXELS // 2, values["normal"], 0)
    write_exr(tmp_path / "holes.exr", {"normal": {c: normal[..., i].astype(np.float32) for i, c in enumerate("RGB")}})
    code, _, err = run_cli(
        "render", tmp_path / "holes.exr", "--blend", folder / "scene.blend", "--camera", "left", "--dome", "1x1",
        "--size", "32x32", "-o", tmp_path / "out", "--quiet",
    )  # fmt: skip
    assert code == 0
    share = re.fullmatch(r"irpso: warning: the maps have no normal at (.*)% of what shows, which is black\n", err)[1]
    assert 35 < float(share) < 65


def test_a_result_is_rendered_with_its_own_model(ball, tmp_path):
    folder, _ = ball
    result_folder = tmp_path / "result"
    result_folder.mkdir()
    shutil.copy(folder / "known.exr", result_folder / "maps.exr")
    (result_folder / "report.json").write_text('{"model": "lambert"}', encoding="utf-8")
    pictures = []
    for number, words in enumerate([[result_folder], [folder / "known.exr", "--model", "lambert"]]):
        code, _, err = run_cli(
            "render", *words, "--blend", folder / "scene.blend", "--camera", "left", "--dome", "3x1",
            "--size", "32x32", "-o", tmp_path / str(number), "--quiet",
        )  # fmt: skip
        assert (code, err) == (0, "")
        pictures.append(read_map(tmp_path / str(number) / "000.exr"))
    np.testing.assert_array_equal(*pictures)


@pytest.mark.parametrize(("seen", "card", "warned"), [(9, False, True), (10, False, False), (9, True, False)])
def test_a_mesh_that_the_photographs_hardly_show_gets_a_warning(seen, card, warned):
    covered = np.arange(100).reshape(10, 10) < seen
    domain = SimpleNamespace(bake=SimpleNamespace(coverage=np.ones((10, 10), bool)), card=card)
    said = result._coverage_warnings(domain, SimpleNamespace(solved=covered))
    assert len(said) == warned and (not warned or "show 9 of the mesh's 100 texels lit" in said[0])


@pytest.mark.parametrize("kind", ["encoded", "empty"])
def test_normals_that_are_none_are_refused_on_a_mesh_as_on_a_card(ball, tmp_path, kind):
    folder, values = ball
    normals = values["normal"].astype(np.float32)
    wrong = 0.5 * normals + 0.5 if kind == "encoded" else np.where(np.indices(normals.shape)[1] < 24, 0, normals)
    write_exr(tmp_path / "normal.exr", {"": {c: wrong[..., i].astype(np.float32) for i, c in enumerate("RGB")}})
    command = [
        "recover", folder / "capture", "--blend", folder / "scene.blend", "--object", "Ball", "--resolution", TEXELS,
        "--quiet", "-o", tmp_path / "out",
    ]  # fmt: skip
    code, _, err = run_cli(*command, "--fixed", f"normal={tmp_path / 'normal.exr'}")
    assert code == 2 and err.count("\n") == 1 and not (tmp_path / "out").exists()
    said = "its vectors have the length 1." if kind == "encoded" else "texels of the subject hold the vector 0, 0, 0"
    assert "fixed normal: " in err and said in err
    code, _, err = run_cli(*command, "--ground-truth", tmp_path / "normal.exr", "--iterations", 5)
    report = json.loads((tmp_path / "out" / "report.json").read_text(encoding="utf-8"))
    whole = report["texels"]
    assert code == 0 and report["ground_truth"]["normal"]["count"] < (0.1 if kind == "encoded" else 0.8) * whole


def test_one_of_the_two_numbers_of_a_grain_is_refused_on_a_mesh(ball, tmp_path):
    folder = ball[0]
    code, _, err = run_cli(
        "recover", folder / "capture", "--blend", folder / "scene.blend", "--object", "Ball", "--resolution", TEXELS,
        "--model", "anisotropic", "--fixed", "slant=0.6", "-o", tmp_path / "out",
    )  # fmt: skip
    assert code == 2 and "--fixed: slant is one of the two numbers of a grain" in err and err.count("\n") == 1
    assert "give both, slant and stretch, or neither" in err and not (tmp_path / "out").exists()


def test_albedo_and_roughness_are_recovered_under_a_known_normal_map(ball):
    folder, values = ball
    normal = values["normal"].astype(np.float32)
    write_exr(folder / "normal.exr", {"": {c: normal[..., i] for i, c in enumerate("RGB")}})
    fixed = ["--fixed", f"normal={folder / 'normal.exr'}", "--fixed", "specular=0.5"]
    recover_ball(folder, "known", *fixed, "--iterations", 500)
    found = read_maps(folder / "known", load_model("principled"))
    seen = seen_texels(folder / "known")
    color = 100 * np.abs(found["base_color"] - values["base_color"]).mean(axis=-1)[seen]
    rough = 100 * np.abs(found["roughness"][..., 0] - values["roughness"])[seen]
    print()
    print_errors({"base_color": (color, " %"), "roughness": (rough, " %")})
    assert angle(found["normal"], values["normal"])[seen].max() < 0.01
    assert np.median(color) < 0.2 and np.median(rough) < 1.5


def cycles(camera, light, width, height):
    """Return (H, W, 3) radiance of the open file under one Sun of intensity 1, row 0 at the bottom."""
    scene = bpy.context.scene
    data = bpy.data.lights.new("sun", "SUN")
    data.energy, data.angle = sun_strength(1.0), 0
    sun = bpy.data.objects.new("sun", data)
    sun.rotation_euler = Vector(light).to_track_quat("Z", "Y").to_euler()
    scene.collection.objects.link(sun)
    scene.camera = camera
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.samples, scene.cycles.use_denoising = "CPU", 16, False
    scene.cycles.max_bounces = 0
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BOX", 1.0
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = width, height, 100
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
    path = bpy.app.tempdir + "cycles.exr"
    scene.render.filepath = path
    bpy.ops.render.render(write_still=True)
    return read_image(path)


def read_image(path):
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = file.channels()
        return np.stack([channels[c].pixels for c in "RGB"], axis=-1)[::-1].astype(np.float64)


def difference(rendered, reference, where=None):
    """Return mean and 99th percentile of |rendered − reference| in per cent of the reference's mean."""
    where = np.ones(reference.shape[:2], bool) if where is None else where
    error = 100 * np.abs(rendered - reference)[where].mean(axis=-1) / reference[where].mean()
    return error.mean(), np.percentile(error, 99)


def test_the_saved_file_holds_the_material_on_the_mesh_with_its_images_packed(ball):
    folder, _ = ball
    bpy.ops.wm.open_mainfile(filepath=str(folder / "out" / "material.blend"))
    (material,) = bpy.data.objects["Ball"].data.materials
    assert material.name == "IRPSO Ball"
    images = {image.name: image for image in bpy.data.images if image.name.startswith("IRPSO")}
    spaces = dict.fromkeys(("normal", "roughness", "metallic", "specular"), "Non-Color") | {"base_color": "sRGB"}
    assert {name: image.colorspace_settings.name for name, image in images.items()} == {
        f"IRPSO Ball {name}": space for name, space in spaces.items()
    }
    assert all(image.packed_file is not None and tuple(image.size) == (TEXELS, TEXELS) for image in images.values())
    assert {"left", "right"} <= set(bpy.data.objects.keys())


def test_cycles_renders_the_recovered_mesh_as_it_was_photographed(ball):
    folder, _ = ball
    bpy.ops.wm.open_mainfile(filepath=str(folder / "out" / "material.blend"))
    light = mesh_lights()[5]
    rendered = cycles(bpy.data.objects["left"], light, PIXELS, PIXELS)
    reference = read_image(folder / "capture" / "005.exr")
    # Away from the outline, where pixels are partly background, and from what neither camera sees well.
    inside = reference.sum(axis=-1) > 0.05
    for axis in (0, 1):
        for step in (-2, 2):
            inside &= np.roll(reference.sum(axis=-1) > 0.05, step, axis)
    mean, worst = difference(rendered, reference, inside)
    print(
        f"\nmesh in Cycles against its capture: mean {mean:.2f} %, 99th percentile {worst:.2f} % of the mean radiance"
    )
    # A texel here is up to 3 × 5 pixels and shows their mean, which rounds off the colour's edge within it: read at the
    # texels' centres, which photographs with finer detail would alias, the two would be 0.5 and 8.
    assert mean < 1.5 and worst < 20


def test_running_again_on_the_saved_file_renews_the_material_and_leaves_the_users_nodes(ball, tmp_path):
    folder, _ = ball
    bpy.ops.wm.open_mainfile(filepath=str(folder / "out" / "material.blend"))
    tree = bpy.data.materials["IRPSO Ball"].node_tree
    hue = tree.nodes.new("ShaderNodeHueSaturation")
    hue.name, hue.inputs["Saturation"].default_value = "mine", 0.25
    tree.links.new(tree.nodes["IRPSO map base_color"].outputs["Color"], hue.inputs["Color"])
    tree.links.new(hue.outputs["Color"], tree.nodes["IRPSO surface"].inputs["Base Color"])
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "mine.blend"), copy=True)
    counts = [len(data) for data in (bpy.data.materials, bpy.data.images, bpy.data.meshes, bpy.data.objects)]
    code, _, err = run_cli(
        "recover", folder / "capture", "--blend", tmp_path / "mine.blend", "--object", "Ball", "--resolution", 16,
        "--iterations", 10, "-o", tmp_path / "out", "--quiet",
    )  # fmt: skip
    assert (code, err) == (0, "")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "out" / "material.blend"))
    assert counts == [len(data) for data in (bpy.data.materials, bpy.data.images, bpy.data.meshes, bpy.data.objects)]
    assert tuple(bpy.data.images["IRPSO Ball base_color"].size) == (16, 16)
    tree = bpy.data.materials["IRPSO Ball"].node_tree
    assert tree.nodes["mine"].inputs["Saturation"].default_value == pytest.approx(0.25)
    links = {(link.from_node.name, link.to_node.name, link.to_socket.name) for link in tree.links}
    assert {("IRPSO map base_color", "mine", "Color"), ("mine", "IRPSO surface", "Base Color")} <= links
    assert ("IRPSO map base_color", "IRPSO surface", "Base Color") not in links


# Largest mean and 99th percentile of the difference, in per cent of the mean radiance.
AGAINST_CYCLES = {
    "lambert": (0.4, 1.2),
    "principled": (0.9, 3.0),
    "cook_torrance_two_lobe": (0.6, 2.0),
    "principled_two_lobe": (0.6, 2.0),
}


ITERATIONS = {"lambert": 400, "principled": 600, "cook_torrance_two_lobe": 600, "principled_two_lobe": 600}


@pytest.mark.parametrize("name", AGAINST_CYCLES)
def test_cycles_renders_the_written_material_as_the_card_was_photographed(name, tmp_path):
    lights = cli_maker.dome_lights(24, widest=65)
    values = cli_maker.smooth_maps(CARD, RANGES[name], seed=6, tilt=20)
    images = cli_maker.render_oracle(name, values, lights)
    capture = cli_maker.write_card(tmp_path / "card", images, lights)
    code, out, err = run_cli(
        "recover", capture, "--model", name, "--iterations", ITERATIONS[name], "-o", tmp_path / "out", "--json"
    )
    assert (code, err) == (0, "")
    residual = json.loads(out.splitlines()[-1])["residual"]["mean"]
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "out" / "material.blend"))
    # Nothing else is in the file: what Blender starts with, or had open, would stand before the card.
    assert [thing.name for thing in bpy.data.objects] == ["IRPSO card"]
    camera = cli_maker.add_camera(bpy, type="ORTHO", ortho_scale=1.0)
    # Cycles reads between texels: leave out the edge of the colour.
    smooth = np.ones(CARD, bool)
    smooth[: CARD[0] // 3 + 1, : CARD[1] // 4 + 1] = False
    means, worsts = [], []
    for k in (3, 12, 20):
        for sun in [thing for thing in bpy.data.objects if thing.type == "LIGHT"]:
            bpy.data.objects.remove(sun)
        mean, worst = difference(cycles(camera, lights[k], CARD[1], CARD[0]), images[k], smooth)
        means, worsts = [*means, mean], [*worsts, worst]
    figures = ", ".join(f"{m:.2f} ({w:.2f})" for m, w in zip(means, worsts, strict=True))
    print(f"\n{name} in Cycles, light at 25°, 47°, 59°: mean (99 %) {figures} % of the mean radiance;"
          f" residual {100 * residual / images.mean():.2f} %")  # fmt: skip
    assert max(means) < AGAINST_CYCLES[name][0] and max(worsts) < AGAINST_CYCLES[name][1]
    shutil.rmtree(tmp_path / "out")
