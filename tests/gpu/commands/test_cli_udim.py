"""UDIM tiles and material slots through the command line, against the same mesh with its islands in one square."""

import json
import signal

import bpy
import numpy as np
import OpenEXR
import pytest
from mathutils import Vector

from irpso_addon.blender.scenes.light_units import sun_strength
from irpso_addon.capture.images.exr import write_exr
from irpso_addon.core.errors import InputError
from irpso_addon.exports import asset
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.read import read_maps
from tests.builders import command_line as cli_maker
from tests.builders.command_line import angle, read_map, run_cli
from tests.builders.exports import read_glb

SIDE = 16  # texels along a tile
PIXELS = (96, 48)
MODEL = ("--model", "lambert")
QUICK = ("--set", "prefit_iterations=0", "--set", "refinement_iterations=0", "--set", "prior_rounds=0")
SLOTS = ("Skin", "Cloth")
TILES = (1001, 1011)
# The lower left corners of the two islands' squares, and how wide those are.
LAYOUTS = {
    "udim": ([(0, 0), (0, 1)], (1, 1)),
    "single": ([(0, 0), (0.5, 0)], (0.5, 1)),
    "shared": ([(0, 0), (0, 0)], (1, 1)),
}


def sheets(layout, cover=False):
    """Return what builds two bent sheets side by side, a material slot each, in one of the layouts, and a camera.

    cover: whether a third sheet, of the second slot, hangs over the left quarter of the first.
    """

    def build(bpy):
        places, size = LAYOUTS[layout]
        columns = 4
        vertices, faces, uvs, slots = [], [], [], []
        for island, place in enumerate(places):
            for k in range(columns):
                u = np.array([k, k + 1, k + 1, k]) / columns
                v = np.array([0, 0, 1, 1])
                faces.append(range(len(vertices), len(vertices) + 4))
                height = 0.15 * np.cos(3 * (u - 0.4)) + 0.05 * v
                vertices += np.stack([2 * island - 2 + 1.9 * u + 0.05, 1.9 * v - 0.95, height], axis=-1).tolist()
                uvs += (np.stack([u, v], axis=-1) * size + place).tolist()
                slots.append(island)
        if cover:
            faces.append(range(len(vertices), len(vertices) + 4))
            vertices += [(-2.5, -2, 1), (-1.475, -2, 1), (-1.475, 2, 1), (-2.5, 2, 1)]
            uvs += (np.array([(0, 0), (0.1, 0), (0.1, 0.1), (0, 0.1)]) + places[1]).tolist()
            slots.append(1)
        thing = cli_maker.add_mesh(bpy, "Sheets", vertices, faces, uvs)
        for name in SLOTS:
            thing.data.materials.append(bpy.data.materials.new(name))
        thing.data.polygons.foreach_set("material_index", slots)
        cli_maker.add_camera(bpy, place=(0, 0, 4), type="ORTHO", ortho_scale=4.2)

    return build


def truth():
    """Maps of both islands, side by side."""
    return cli_maker.smooth_maps((SIDE, 2 * SIDE), {}, seed=2, tilt=20)


def write_truth(folder, values, tiles):
    """Write maps as files of their tiles, or as one."""
    for index, number in enumerate(tiles or [0]):
        columns = slice(index * SIDE, (index + 1) * SIDE) if tiles else slice(None)
        parts = {
            name: {c: value[:, columns, i].astype(np.float32) for i, c in enumerate("RGB")}
            for name, value in values.items()
        }
        write_exr(folder / (f"maps.{number}.exr" if tiles else "maps.exr"), parts)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with scenes of each layout, true maps, a capture, and what was recovered of it in two layouts."""
    folder = tmp_path_factory.mktemp("udim")
    np.savetxt(folder / "lights.txt", cli_maker.dome_lights(14, widest=50))
    (folder / "truth").mkdir()
    write_truth(folder / "truth", truth(), TILES)
    write_truth(folder / "truth", truth(), None)
    for layout in LAYOUTS:
        cli_maker.save_scene(folder / f"{layout}.blend", sheets(layout))
    for layout, maps in (("udim", "maps.<UDIM>.exr"), ("single", "maps.exr")):
        done(
            "render", folder / "truth" / maps, "--blend", folder / f"{layout}.blend", "--lights",
            folder / "lights.txt", "--size", "x".join(map(str, PIXELS)), "-o", folder / f"capture {layout}", *MODEL,
        )  # fmt: skip
    for layout, size, maps in (("udim", SIDE, "maps.<UDIM>.exr"), ("single", f"{2 * SIDE}x{SIDE}", "maps.exr")):
        recover(folder, layout, f"out {layout}", "--resolution", size, "--ground-truth", folder / "truth" / maps)
    return folder


def recover(folder, layout, out, *arguments):
    return done(
        "recover", folder / "capture single", "--blend", folder / f"{layout}.blend", "--iterations", 40, *MODEL, *QUICK,
        *arguments, "-o", folder / out,
    )  # fmt: skip


def done(*arguments):
    """Run a command that must succeed and return what it says in JSON."""
    code, out, err = run_cli(*arguments, "--quiet", "--json")
    assert (code, err) == (0, "")
    return json.loads(out.splitlines()[-1])


def test_udim_maps_render_like_maps_of_one_square(folder):
    # In one square the islands meet, and the half texel on each side of their border mixes both; tiles end there.
    column = ((np.arange(PIXELS[0]) + 0.5) / PIXELS[0] - 0.5) * 4.2
    apart = np.abs(column) > 0.05 + 1.9 / SIDE / 2 - 1e-6
    assert apart.sum() == PIXELS[0] - 4
    for k in (0, 7, 13):
        of_tiles, of_one = (read_map(folder / f"capture {name}" / f"{k:03d}.exr") for name in ("udim", "single"))
        assert of_one[..., :3].max() > 0.3
        np.testing.assert_allclose(of_tiles[:, apart], of_one[:, apart], atol=1e-6)


def test_the_files_of_each_tile_equal_one_square_bit_for_bit(folder):
    tiles, one = folder / "out udim", folder / "out single"
    for stem in ("base_color", "normal", "residual"):
        parts = [read_map(tiles / f"{stem}.{number}.exr") for number in TILES]
        assert all(part.shape[:2] == (SIDE, SIDE) for part in parts)
        inside = np.concatenate([read_map_part(tiles / f"maps.{n}.exr", "coverage") for n in TILES], axis=1) > 0
        assert inside.mean() > 0.9
        np.testing.assert_array_equal(np.concatenate(parts, axis=1)[inside], read_map(one / f"{stem}.exr")[inside])
    listed = json.loads((tiles / "report.json").read_text())["files"]
    assert {f"{stem}.{n}.{kind}" for stem in ("base_color", "normal") for n in TILES for kind in ("png", "exr")} <= set(
        listed
    )
    assert sorted(listed) == sorted(path.name for path in tiles.iterdir() if path.suffix != ".blend")


def read_map_part(path, name):
    with OpenEXR.File(str(path), separate_channels=True) as file:
        (part,) = (part for part in file.parts if part.name() == name)
        return part.channels["Y"].pixels[::-1]


def test_recovered_udim_maps_match_the_truth_and_the_report_agrees(folder):
    found = read_maps(folder / "out udim", load_model("lambert"), TILES)
    fixed = truth()
    inside = np.concatenate([read_map_part(folder / "out udim" / f"maps.{n}.exr", "coverage") for n in TILES], 1) > 0
    error = angle(found["normal"], fixed["normal"])[inside]
    said = [
        json.loads((folder / out / "report.json").read_text())["ground_truth"] for out in ("out udim", "out single")
    ]
    assert said[0] == said[1]
    assert np.median(error) < 1 and said[0]["normal"]["median"] == pytest.approx(np.median(error), abs=0.2)


def test_known_maps_are_read_from_the_files_of_their_tiles(folder):
    recover(
        folder, "udim", "known", "--resolution", SIDE, "--fixed",
        f"normal={folder / 'out udim'}/normal.<UDIM>.exr",
    )  # fmt: skip
    found, fixed = (read_maps(folder / out, load_model("lambert"), TILES) for out in ("known", "out udim"))
    assert angle(found["normal"], fixed["normal"]).max() < 0.05
    assert np.abs(found["base_color"] - truth()["base_color"]).mean() < 0.02


def cycles(path, direction):
    """Return (H, W, 3) what Cycles renders of a .blend's camera under a sun."""
    bpy.ops.wm.open_mainfile(filepath=str(path))
    scene = bpy.context.scene
    data = bpy.data.lights.new("Sun", "SUN")
    data.energy, data.angle = sun_strength(1.0), 0.0
    sun = bpy.data.objects.new("Sun", data)
    sun.rotation_euler = Vector(direction).to_track_quat("Z", "Y").to_euler()
    scene.collection.objects.link(sun)
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.samples, scene.cycles.use_denoising = "CPU", 8, False
    scene.cycles.max_bounces = 0
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BOX", 1.0
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = *PIXELS, 100
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
    scene.render.filepath = bpy.app.tempdir + "cycles.exr"
    bpy.ops.render.render(write_still=True)
    return read_map(scene.render.filepath)[..., :3]


def test_cycles_renders_the_tiled_material_as_that_of_one_square_and_as_it_was_photographed(folder):
    light = cli_maker.dome_lights(14, widest=50)[5]
    tiled, single = (cycles(folder / f"out {name}" / "material.blend", light) for name in ("udim", "single"))
    bpy.ops.wm.open_mainfile(filepath=str(folder / "out udim" / "material.blend"))
    images = [image for image in bpy.data.images if image.name.startswith("IRPSO")]
    assert {image.source for image in images} == {"TILED"} and len(images) == 2
    for image in images:
        assert tuple(tile.number for tile in image.tiles) == TILES and image.filepath.startswith("//textures/")
        assert [(f.tile_number, f.filepath) for f in image.packed_files] == [
            (n, f"//textures/{image.name.replace(' ', '_')}.{n}.png") for n in TILES
        ]
    photograph = read_map(folder / "capture single" / "005.exr")[..., :3]
    mean = photograph[photograph > 0].mean()
    # At the tiles' borders the one blends into the gap between islands and the other does not: half a texel, 3 pixels.
    inside = np.zeros(photograph.shape[:2], bool)
    for x0 in (0, PIXELS[0] // 2):
        inside[6:-6, x0 + 5 : x0 + PIXELS[0] // 2 - 5] = True
    between, against = (np.abs(tiled - other)[inside].mean(axis=-1) / mean for other in (single, photograph))
    print(f"\ntiled against one square: {between.mean():.4f}, photograph: {against.mean():.4f} of the mean radiance")
    assert tiled[inside].min() > 0 and between.mean() < 2e-3 and np.percentile(between, 99) < 0.02
    assert against.mean() < 0.03


def test_slots_with_overlapping_uvs_are_refused_together_and_recovered_one_by_one(folder):
    start = "recover", folder / "capture single", "--blend", folder / "shared.blend", "--resolution", SIDE, *MODEL
    code, _, err = run_cli(*start, "-o", folder / "refused", "--quiet")
    assert code == 2 and "overlaps itself over 100 %" in err and not (folder / "refused").exists()
    assert "because the material slots 'Skin', 'Cloth' share it; recover them one by one (--slots)" in err
    reference = read_maps(folder / "out single", load_model("lambert"))
    for index, name in enumerate(SLOTS):
        recover(folder, "shared", f"by/{name}", "--resolution", SIDE, "--slots", (name, "1")[index])
        found = read_maps(folder / "by" / name, load_model("lambert"))
        part = {key: value[:, index * SIDE : (index + 1) * SIDE] for key, value in reference.items()}
        # Other random numbers, and no neighbours from the other island.
        assert np.percentile(angle(found["normal"], part["normal"]), 95) < 0.3
        assert np.percentile(np.abs(found["base_color"] - part["base_color"]), 95) < 0.01
        bpy.ops.wm.open_mainfile(filepath=str(folder / "by" / name / "material.blend"))
        held = [slot.material.name for slot in bpy.data.objects["Sheets"].material_slots]
        expected = list(SLOTS)
        expected[index] = f"IRPSO Sheets {name}"
        assert held == expected
        assert json.loads((folder / "by" / name / "report.json").read_text())["solved_slots"] == [index]


def test_a_material_of_several_slots_goes_into_all_of_them_and_keeps_its_name(folder, tmp_path):
    bpy.ops.wm.open_mainfile(filepath=str(folder / "out udim" / "material.blend"))
    held = [slot.material.name for slot in bpy.data.objects["Sheets"].material_slots]
    assert held == ["IRPSO Sheets"] * 2
    again = (
        "recover", folder / "capture single", "--blend", folder / "by" / "Skin" / "material.blend", "--resolution", 8,
        "--iterations", 5, *MODEL, *QUICK, "--slots", "0", "-o", tmp_path / "out",
    )  # fmt: skip
    done(*again)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "out" / "material.blend"))
    assert [slot.material.name for slot in bpy.data.objects["Sheets"].material_slots] == ["IRPSO Sheets Skin", "Cloth"]


def test_slots_in_turn_equal_single_slots_and_one_file_holds_all_materials(folder, tmp_path):
    said = recover(folder, "shared", tmp_path / "out", "--resolution", SIDE, "--slots", "each")
    assert list(said["slots"]) == list(SLOTS)
    assert json.loads((tmp_path / "out" / "report.json").read_text())["texels"] == said["texels"] > SIDE * SIDE
    for name in SLOTS:
        together, alone = (
            read_maps(place / name, load_model("lambert")) for place in (tmp_path / "out", folder / "by")
        )
        for key in together:
            np.testing.assert_array_equal(together[key], alone[key])
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "out" / "material.blend"))
    held = [slot.material.name for slot in bpy.data.objects["Sheets"].material_slots]
    assert held == [f"IRPSO Sheets {name}" for name in SLOTS]
    glb = tmp_path / "cloth.glb"
    done("export", tmp_path / "out" / SLOTS[1], "--format", "gltf", "-o", glb)
    names = {material["name"] for material in read_glb(glb)[0]["materials"]}
    assert names == {SLOTS[1], f"IRPSO Sheets {SLOTS[0]}"}


@pytest.mark.parametrize(("name", "said"), [("material.blend", "no recovery wrote it"), ("maps.exr", "whose report")])
def test_slots_in_turn_replace_neither_files_of_others_nor_the_report_of_a_mesh(folder, tmp_path, name, said):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / name).write_bytes(b"former")
    if name == "maps.exr":
        (tmp_path / "out" / "report.json").write_text(json.dumps({"files": [name]}))
    code, _, err = run_cli(
        "recover", folder / "capture single", "--blend", folder / "udim.blend", *MODEL, "--slots", "each", "-o",
        tmp_path / "out", "--quiet",
    )  # fmt: skip
    assert code == 2 and name in err and said in err
    assert (tmp_path / "out" / name).read_bytes() == b"former"


def test_assets_of_slots_in_turn_are_written_after_the_last_and_refused_before_the_first(folder, tmp_path, monkeypatch):
    arguments = (
        "recover", folder / "capture single", "--blend", folder / "shared.blend", "--resolution", 8, "--iterations", 5,
        *MODEL, *QUICK, "--slots", "each", "--quiet",
    )  # fmt: skip
    library = tmp_path / "library"
    written = []

    def write(path, obj, material, name, about, catalog):
        assert (tmp_path / "out" / "material.blend").is_file() and about.author == "me"
        path.touch()
        written.append((path.name, material.name, name))

    monkeypatch.setattr(asset, "write_asset", write)
    words = ("--asset", library, "--author", "me")
    assert run_cli(*arguments, *words, "-o", tmp_path / "out")[0] == 0
    assert written == [(f"Sheets_{name}.blend", f"IRPSO Sheets {name}", f"Sheets {name}") for name in SLOTS]
    (library / "Sheets_Skin.blend").unlink()
    code, _, err = run_cli(*arguments, *words, "-o", tmp_path / "more")
    assert code == 2 and "slot 'Cloth': " in err and "Sheets_Cloth.blend: the library has this file already" in err
    assert not (tmp_path / "more").exists() and not (library / "Sheets_Skin.blend").exists()
    monkeypatch.setattr(asset, "file_stem", lambda name: "same")
    code, _, err = run_cli(*arguments, *words, "-o", tmp_path / "more")
    assert code == 2 and "slot 'Cloth': its asset would have the file of 'Skin'" in err


@pytest.mark.parametrize("stop", [None, signal.SIGINT], ids=["full", "signal"])
def test_assets_of_slots_are_written_all_or_none_and_the_run_can_be_repeated(folder, tmp_path, monkeypatch, stop):
    arguments = (
        "recover", folder / "capture single", "--blend", folder / "shared.blend", "--resolution", 8, "--iterations", 5,
        *MODEL, *QUICK, "--slots", "each", "--quiet", "--asset", tmp_path / "library", "-o", tmp_path / "out",
    )  # fmt: skip
    written = []

    def write(path, *words):
        if len(written) == 1 and stop is None:
            written.append(None)
            raise InputError(f"{path}: cannot be written (No space left on device); choose another library")
        path.touch()
        written.append(path)
        if len(written) == 1 and stop is not None:
            signal.raise_signal(stop)

    monkeypatch.setattr(asset, "write_asset", write)
    code, _, err = run_cli(*arguments)
    assert code == (2 if stop is None else 130) and not list((tmp_path / "library").iterdir())
    assert stop or "slot 'Cloth': " in err
    assert f"irpso export {tmp_path / 'out' / 'SLOT'} --format asset -o {tmp_path / 'library'}" in err
    assert "'Skin', 'Cloth'" in err
    assert run_cli(*arguments)[0] == 0
    assert {path.name for path in (tmp_path / "library").iterdir()} == {f"Sheets_{name}.blend" for name in SLOTS}


def test_a_slot_that_fails_names_the_command_that_makes_assets_of_those_before(folder, tmp_path):
    (tmp_path / "out" / "Cloth").mkdir(parents=True)
    (tmp_path / "out" / "Cloth" / "maps.exr").write_bytes(b"theirs")
    code, _, err = run_cli(
        "recover", folder / "capture single", "--blend", folder / "shared.blend", "--resolution", 8, "--iterations", 5,
        *MODEL, *QUICK, "--slots", "each", "--quiet", "--asset", tmp_path / "library", "-o", tmp_path / "out",
    )  # fmt: skip
    assert code == 2 and "slot 'Cloth': " in err and "maps.exr" in err
    assert f"the finished slots ('Skin') as assets: irpso export {tmp_path / 'out' / 'SLOT'} --format asset" in err
    assert not (tmp_path / "library").exists()


def test_other_slots_have_no_texels_but_occlude(folder, tmp_path):
    cli_maker.save_scene(tmp_path / "covered.blend", sheets("shared", cover=True))
    done(
        "recover", folder / "capture single", "--blend", tmp_path / "covered.blend", "--resolution", SIDE, "--slots",
        "Skin", "--iterations", 5, *MODEL, *QUICK, "-o", tmp_path / "out",
    )  # fmt: skip
    solved = read_map_part(tmp_path / "out" / "maps.exr", "coverage") > 0
    x = -2 + 1.9 * (np.arange(SIDE) + 0.5) / SIDE + 0.05
    hidden = x < -1.475
    # A pixel is 0.044 wide, a texel 0.12: those within a pixel of the cover's edge may be either.
    clear = np.abs(x + 1.475) > 0.09
    assert hidden.sum() == 4 and clear.sum() >= SIDE - 2
    assert not solved[:, hidden & clear].any() and solved[1:-1, ~hidden & clear][:, :-1].all()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--slots", "each", "--resume"), "--resume: resume only the interrupted slot"),
        (("--slots", "Hair"), "--slots Hair: there is no slot 'Hair'; the slots are 0 'Skin', 1 'Cloth'"),
        (("--ground-truth", "{truth}/maps.exr"), "is one picture, the UV map has the UDIM tiles 1001, 1011"),
        (("--fixed", "normal={truth}/maps.1002.<UDIM>.exr"), "has no file for UDIM tile 1001 (2 of 2 are missing)"),
        (("--resolution", "16384x16", "--slots", "1,0"), None),
    ],
)
def test_bad_input_is_one_line_and_nothing_is_written(folder, tmp_path, arguments, said):
    arguments = [text.format(truth=folder / "truth") for text in arguments]
    code, out, err = run_cli(
        "recover", folder / "capture single", "--blend", folder / "udim.blend", *MODEL, *arguments, "-o",
        tmp_path / "out", "--quiet", *(("--dry-run",) if said is None else ()),
    )  # fmt: skip
    assert not (tmp_path / "out").exists()
    if said is None:  # twice as wide as a tile, and still a plan
        assert (code, err) == (0, "")
        return
    assert code == 2 and said in err and len(err.splitlines()) == 1
