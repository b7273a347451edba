"""Lights from balls that Cycles has rendered, on a table that reflects, with blur and noise; and the command."""

import json
import math

import numpy as np
import pytest

from irpso_addon.calibration.balls.ball import fit_ball, outline_of_mask
from irpso_addon.calibration.balls.lights import Request, calibration_steps
from irpso_addon.capture.camera import Camera
from irpso_addon.capture.images.exr import read_exr, write_exr
from irpso_addon.capture.read import read_capture
from irpso_addon.core.steps import run_steps
from tests.builders.balls import cap, degrees, photographed, trace, unit
from tests.builders.command_line import listing, run_cli

pytestmark = pytest.mark.bpy_only

FOV, WIDTH, HEIGHT, RADIUS = 40.0, 240, 200, 0.75
CAMERA = Camera.from_fov(WIDTH, HEIGHT, FOV)
UP = unit([0, 0.5, 1])
TABLE = np.array([0, 0, -7.5])
ALBEDO = 0.35
RIGHT, FAR = np.array([1.0, 0, 0]), unit(np.cross(UP, [1.0, 0, 0]))
CENTRES = {
    kind: [TABLE + UP * RADIUS + x * RIGHT + y * FAR for x in (-1.75, 1.75)]
    for kind, y in (("mirror", 1.3), ("matte", -1.3))
}
MIDDLE = np.mean([c for centres in CENTRES.values() for c in centres], axis=0)
LIGHTS = np.array([light for light in cap(11, 68, seed=1) if light @ UP > 0.35])
PLACES = MIDDLE + LIGHTS[:4] * np.array([4.0, 5.0, 4.5, 6.0])[:, None]
SPOILED = {"clean": {}, "blurred and noisy": {"blur": 1.2, "noise": 0.01}}


def built(bpy):
    """The scene: two chrome and two matte balls and a box on a table, a weak world, a camera at the origin."""
    from mathutils import Vector

    scene = bpy.context.scene

    def material(node, color, roughness):
        made = bpy.data.materials.new(node)
        made.use_nodes = True
        tree = made.node_tree
        tree.nodes.clear()
        surface = tree.nodes.new(node)
        surface.inputs["Color"].default_value = (*color, 1)
        surface.inputs["Roughness"].default_value = roughness
        tree.links.new(surface.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs[0])
        return made

    kinds = {
        "mirror": material("ShaderNodeBsdfAnisotropic", (0.9, 0.9, 0.9), 0.05),
        "matte": material("ShaderNodeBsdfDiffuse", (0.6, 0.6, 0.6), 0.0),
    }
    for kind, centres in CENTRES.items():
        for centre in centres:
            bpy.ops.mesh.primitive_uv_sphere_add(segments=128, ring_count=64, radius=RADIUS, location=centre)
            bpy.ops.object.shade_smooth()
            bpy.context.object.data.materials.append(kinds[kind])
    bpy.ops.mesh.primitive_cube_add(size=0.8, location=TABLE + 0.4 * UP)
    bpy.context.object.data.materials.append(material("ShaderNodeBsdfDiffuse", (0.8, 0.3, 0.2), 0.0))
    bpy.ops.mesh.primitive_plane_add(size=40, location=TABLE)
    bpy.context.object.rotation_mode = "QUATERNION"
    bpy.context.object.rotation_quaternion = Vector(UP).to_track_quat("Z", "Y")
    bpy.context.object.data.materials.append(material("ShaderNodeBsdfDiffuse", (ALBEDO,) * 3, 0.0))
    scene.world = bpy.data.worlds.new("world")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.01, 0.01, 0.01, 1)
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.angle = math.radians(FOV)
    lamps = [bpy.data.objects.new(kind, bpy.data.lights.new(kind, kind)) for kind in ("SUN", "POINT")]
    for thing in (camera, *lamps):
        scene.collection.objects.link(thing)
    scene.camera = camera
    lamps[0].data.angle, lamps[0].data.energy, lamps[0].rotation_mode = math.radians(5), math.pi, "QUATERNION"
    lamps[1].data.shadow_soft_size, lamps[1].data.energy = 0.12, 4 * math.pi**2 * 25
    return scene, lamps


def rendered(bpy, folder):
    """Images (H, W, 3), row 0 at the bottom, under the suns and under the points."""
    from mathutils import Vector

    scene, (sun, point) = built(bpy)
    scene.render.engine, scene.cycles.device, scene.cycles.samples = "CYCLES", "CPU", 16
    scene.cycles.use_adaptive_sampling, scene.cycles.use_denoising, scene.cycles.max_bounces = False, False, 2
    scene.render.resolution_x, scene.render.resolution_y = WIDTH, HEIGHT
    scene.render.resolution_percentage = 100
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"

    def shoot(number):
        scene.render.filepath = str(folder / f"{number}.exr")
        bpy.ops.render.render(write_still=True)
        channels = read_exr(folder / f"{number}.exr")[""]
        return np.stack([channels[c] for c in "RGB"], axis=-1)

    point.hide_render = True
    suns, points = [], []
    for number, light in enumerate(LIGHTS):
        sun.rotation_quaternion = Vector(light).to_track_quat("Z", "Y")
        suns.append(shoot(number))
    sun.hide_render, point.hide_render = True, False
    for number, place in enumerate(PLACES, len(LIGHTS)):
        point.location = place
        points.append(shoot(number))
    return np.array(suns), np.array(points)


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    """What Cycles makes of the suns and of the points, once for all."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    return rendered(bpy, tmp_path_factory.mktemp("cycles"))


def found(images, kind, shot, count=1):
    rng, clip = np.random.default_rng(7), 1.0 if kind == "mirror" and shot != "clean" else None
    shots = [photographed(image, rng, clip=clip, **SPOILED[shot]) for image in images]
    balls = [
        fit_ball(outline_of_mask(trace(CAMERA, c, RADIUS)[3]), CAMERA, radius=RADIUS) for c in CENTRES[kind][:count]
    ]
    result = run_steps(calibration_steps([lambda s=s: s for s in shots], balls, Request(kind)))
    return result, np.array([light.light.vector for light in result.lights])


@pytest.mark.parametrize("shot", SPOILED)
def test_directions_from_a_mirror_ball_are_within_a_degree(pictures, shot):
    result, vectors = found(pictures[0], "mirror", shot)
    off = degrees(vectors, LIGHTS)
    print(f"mirror, {shot}: mean {off.mean():.2f}°, largest {off.max():.2f}°")
    assert not result.near and off.mean() < 0.5 and off.max() < 1.0


@pytest.mark.parametrize("shot", SPOILED)
def test_directions_from_a_matte_ball_are_within_two_degrees(pictures, shot):
    result, vectors = found(pictures[0], "matte", shot)
    off = degrees(vectors, LIGHTS)
    strengths = np.array([light.light.intensity for light in result.lights])
    print(f"matte, {shot}: mean {off.mean():.2f}°, largest {off.max():.2f}°; intensities {strengths.std(axis=0)}")
    assert not result.near and off.mean() < 1.0 and off.max() < 2.0
    assert np.abs(strengths / strengths.mean(axis=0) - 1).max() < 0.06
    # The table is told from its light alone: its normal and, within what the balls' shadows take, its albedo.
    assert degrees(result.bounce, UP) < 15 and 0.2 < np.linalg.norm(result.bounce) < 0.45


@pytest.mark.parametrize("shot", SPOILED)
@pytest.mark.parametrize(("kind", "worst"), [("mirror", 0.06), ("matte", 0.12)])
def test_two_balls_give_positions_of_near_lights(pictures, shot, kind, worst):
    result, vectors = found(pictures[1], kind, shot, 2)
    off = np.linalg.norm(vectors - PLACES, axis=1) / np.linalg.norm(PLACES - MIDDLE, axis=1)
    print(f"near, {kind}, {shot}: mean {off.mean():.1%}, largest {off.max():.1%}")
    assert result.near and off.max() < worst


def test_two_balls_recognise_distant_lights(pictures):
    result, vectors = found(pictures[0], "mirror", "blurred and noisy", 2)
    assert not result.near and "do not converge" in result.how
    assert degrees(vectors, LIGHTS).max() < 1.0


@pytest.fixture(scope="module")
def folder(pictures, tmp_path_factory):
    """The suns' images in a folder, with a mask of the first ball of each kind."""
    folder = tmp_path_factory.mktemp("shots")
    (folder / "images").mkdir()
    for number, image in enumerate(pictures[0]):
        write_exr(folder / "images" / f"shot {number:02d}.exr", {"": {c: image[..., i] for i, c in enumerate("RGB")}})
    for kind, centres in CENTRES.items():
        mask = trace(CAMERA, centres[0], RADIUS)[3]
        write_exr(folder / f"{kind}.exr", {"": {"Y": mask.astype(np.float32)}})
    return folder


def test_the_command_writes_a_capture_that_holds_the_lights(folder, tmp_path):
    out = tmp_path / "out"
    code, said, _ = run_cli("calibrate", folder / "images", "--ball", folder / "mirror.exr", "--kind", "mirror",
                            "--fov", FOV, "-o", out, "--json")  # fmt: skip
    printed = json.loads(said.splitlines()[-1])
    assert code == 0 and printed["lights"] == len(LIGHTS) and not printed["near"]
    capture = read_capture(out)
    assert degrees([o.light.vector for o in capture.observations], LIGHTS).max() < 1.0
    assert capture.cameras[0].perspective and capture.observations[3].read().shape == (HEIGHT, WIDTH, 4)
    np.testing.assert_allclose(
        np.loadtxt(out / "light_directions.txt"), [o.light.vector for o in capture.observations], atol=1e-7
    )
    assert len(json.loads((out / "report.json").read_text())["lights"]) == len(LIGHTS)
    assert (out / "balls.png").stat().st_size > 10_000


def test_calibration_changes_only_the_lights_of_a_table(folder, tmp_path):
    rows = "".join(
        f'\n[[observation]]\nimage = "images/shot {n:02d}.exr"\nlight_direction = [0.0, 0.0, 1.0]\n'
        for n in range(len(LIGHTS))
    )
    table = folder / "table.toml"
    table.write_text(f'format = 1\nname = "four balls"\n\n[[camera]]\nname = "top"\nfov_degrees = {FOV}\n{rows}')
    out = tmp_path / "new.toml"
    code, _, said = run_cli("calibrate", table, "--ball", folder / "matte.exr", "--kind", "matte", "--albedo", 0.6,
                            "-o", out, "--quiet")  # fmt: skip
    assert code == 0, said
    capture = read_capture(out)
    assert capture.name == "four balls" and capture.cameras[0].perspective
    assert degrees([o.light.vector for o in capture.observations], LIGHTS).max() < 2.0
    np.testing.assert_allclose([o.light.intensity for o in capture.observations], 1.0, atol=0.06)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["new.toml", "new_balls.png", "new_report.json"]


def test_points_of_the_outline_count_from_the_upper_left(folder, tmp_path):
    rim = fit_ball(outline_of_mask(trace(CAMERA, CENTRES["mirror"][0], RADIUS)[3]), CAMERA).outline[[10, 70, 130, 40]]
    points = ",".join(f"{x:.2f},{HEIGHT - y:.2f}" for x, y in rim)
    code, _, said = run_cli("calibrate", folder / "images", "--ball", points, "--kind", "mirror", "--fov", FOV,
                            "-o", tmp_path / "out", "--quiet")  # fmt: skip
    assert code == 0, said
    assert degrees(np.loadtxt(tmp_path / "out" / "light_directions.txt"), LIGHTS).max() < 1.2


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        (["--ball", "nowhere.png"], "there is no such file"),
        (["--ball", "10,20"], "three or more points"),
        (["--ball", "900,20,30"], "outside the image"),
        (["--fov", "180"], "below 180"),
        (["--albedo", "2"], "above 0 and up to 1"),
        (["--lights", "near"], "second --ball"),
        (["--view", "left"], "no such camera"),
        (["--radius", "-1"], "above 0"),
        (["--kind", "glass"], "choose from"),
        (["--kind", "auto"], "give --kind mirror or --kind matte"),
    ],
)
def test_bad_input_is_reported_in_one_line_and_nothing_is_written(folder, tmp_path, changed, words):
    arguments = {"--ball": "70,60,30", "--kind": "mirror", "--fov": "40"} | {changed[0]: changed[1]}
    flat = [word for pair in arguments.items() for word in pair]
    before = listing(folder)
    code, _, said = run_cli("calibrate", folder / "images", *flat, "-o", tmp_path / "out", "--quiet")
    assert code == 2 and words in said and said.count("\n") == 1
    assert listing(folder) == before and not (tmp_path / "out").exists()


def test_without_a_place_and_a_kind_the_command_finds_the_balls(folder, tmp_path):
    code, said, errors = run_cli("calibrate", folder / "images", "--fov", FOV, "-o", tmp_path / "out")
    assert code == 0, errors
    assert "found: m" in said, said
    directions = np.loadtxt(tmp_path / "out" / "light_directions.txt")
    assert degrees(directions, LIGHTS).max() < 3.0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert len(report["found"]) > 1, said


def test_photographs_without_a_ball_are_one_line_that_names_the_remedy(folder, tmp_path):
    (tmp_path / "bare").mkdir()
    rng = np.random.default_rng(1)
    for number in range(4):
        noise = rng.uniform(0.2, 0.3, (HEIGHT, WIDTH)).astype(np.float32)
        write_exr(tmp_path / "bare" / f"{number}.exr", {"": dict.fromkeys("RGB", noise)})
    code, _, said = run_cli("calibrate", tmp_path / "bare", "-o", tmp_path / "out", "--quiet")
    assert code == 2 and "paint a mask" in said and said.count("\n") == 1 and not (tmp_path / "out").exists()


def test_nothing_is_overwritten(folder, tmp_path):
    (tmp_path / "capture.toml").write_text("mine")
    code, _, said = run_cli("calibrate", folder / "images", "--ball", folder / "mirror.exr", "--kind", "mirror",
                            "-o", tmp_path / "capture.toml", "--quiet")  # fmt: skip
    assert code == 2 and "exists" in said and (tmp_path / "capture.toml").read_text() == "mine"
