"""Exports read back by hand: OpenLIME by its shader's formulas, PTM by its format's description."""

import json
import shutil
from dataclasses import replace

import bpy
import numpy as np
import pytest

from irpso_addon.core.paths import MODELS
from irpso_addon.exports import formats, openlime, ptm, textures
from irpso_addon.exports.result import Result, read_result
from irpso_addon.geometry.relief.height import Height
from irpso_addon.geometry.relief.occlusion import open_sky
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.derived_map import height_map
from irpso_addon.results.maps import Maps
from irpso_addon.results.write import write_maps
from tests.builders import command_line as cli_maker
from tests.builders.command_line import run_cli
from tests.builders.exports import SHAPE, on_a_sheet, picture, read_glb, result_of, srgb, unsrgb
from tests.oracles import reflectance as oracles


@pytest.fixture(autouse=True)
def empty_file():
    bpy.ops.wm.read_factory_settings(use_empty=True)


# --- textures -------------------------------------------------------------------------------------------------------


def test_a_texture_set_holds_each_map_under_the_usual_names(tmp_path):
    result = result_of("principled")
    values = np.linspace(-2, 3, 560, dtype=np.float32)
    values[1:-1] = np.random.default_rng(0).uniform(-2, 3, 558)
    height = Height(values.reshape(SHAPE), np.ones(SHAPE, bool), "texels")
    found = textures.write_textures(Result("leaf", result.maps, height), tmp_path / "set")
    names = {
        f"leaf_{n}.png" for n in ("BaseColor", "Normal", "Roughness", "Metallic", "Specular", "ORM", "AO", "Height")
    }
    assert set(found["files"]) == names == {path.name for path in (tmp_path / "set").iterdir()}
    v, shown = result.maps.values, {n[5:-4]: picture(tmp_path / "set" / n)[..., :3] for n in names}
    np.testing.assert_allclose(shown["BaseColor"], srgb(v["base_color"]), atol=0.51 / 255)
    np.testing.assert_allclose(shown["Normal"], v["normal"] * 0.5 + 0.5, atol=1e-5)
    np.testing.assert_allclose(shown["Roughness"][..., :1], v["roughness"], atol=0.51 / 255)
    np.testing.assert_allclose(shown["Specular"][..., :1], v["specular"], atol=0.51 / 255)
    assert open_sky(height).min() < 0.9
    np.testing.assert_allclose(shown["AO"][..., 0], open_sky(height), atol=0.51 / 255)
    orm = np.stack([open_sky(height), v["roughness"][..., 0], np.zeros(SHAPE)], axis=-1)
    np.testing.assert_allclose(shown["ORM"], orm, atol=0.51 / 255)
    np.testing.assert_allclose(shown["Height"][..., 0] * 5 - 2, height.values, atol=1e-4)


def test_a_texture_set_says_where_a_dielectric_reflects_more_than_it_holds(tmp_path):
    made = result_of("principled")
    glass = replace(made.maps.model, material={"shader": "principled", "settings": {"IOR": 2.4}})
    too_much = (2 * made.maps.values["specular"] * (1.4 / 3.4) ** 2 > 0.0802).mean()
    found = textures.write_textures(Result("leaf", replace(made.maps, model=glass)), tmp_path / "glass")
    text = "_Specular holds a reflectance of at most 8%: the highlight of {:.2%} of the texels is too dark"
    assert 0.5 < too_much < 1 and found["warnings"] == [f"leaf: {text.format(too_much)}"]
    assert "warnings" not in textures.write_textures(made, tmp_path / "plain")


def test_without_a_relief_and_on_a_mesh_occlusion_is_unknown(tmp_path):
    result = result_of("principled")
    fine = Height(np.linspace(-2, 3, 560, dtype=np.float32).reshape(SHAPE), np.ones(SHAPE, bool), "world")
    for name, height in (("none", None), ("mesh", fine)):
        textures.write_textures(Result("leaf", result.maps, height), tmp_path / name)
        assert (picture(tmp_path / name / "leaf_ORM.png")[..., 0] == 1).all()
        assert not (tmp_path / name / "leaf_AO.png").exists()


@pytest.mark.parametrize(
    ("convention", "name", "turned"),
    [("unreal", "T_leaf_N", True), ("unity", "leaf_Normal", False), ("substance", "leaf_Normal_DirectX", True)],
)
def test_each_program_gets_its_normal_convention(convention, name, turned, tmp_path):
    result = result_of("principled")
    textures.write_textures(result, tmp_path, convention)
    green = picture(tmp_path / f"{name}.png")[..., 1] * 2 - 1
    np.testing.assert_allclose(green, (-1 if turned else 1) * result.maps.values["normal"][..., 1], atol=5e-5)


def coated():
    """A result of the model with a clear coat."""
    made, model = result_of("principled"), load_model("clear_coat")
    coat = {p.name: np.full((*SHAPE, p.components), 0.3, np.float32) for p in model.parameters}
    values = coat | {name: value for name, value in made.maps.values.items() if name in coat}
    return Result("leaf", replace(made.maps, model=model, values=values))


def test_a_texture_set_holds_what_no_program_has_a_name_for_unchanged(tmp_path):
    result = coated()
    found = textures.write_textures(result, tmp_path, "unreal")
    assert {f"T_leaf_{n}.png" for n in ("BC", "N", "ORM", "S", "CoatWeight", "CoatRoughness")} == set(found["files"])
    coat = picture(tmp_path / "T_leaf_CoatWeight.png")[..., :1]
    np.testing.assert_allclose(coat, result.maps.values["coat_weight"], atol=1e-4)


def test_formats_of_one_lobe_name_what_they_leave_out(tmp_path):
    found = formats.export(coated(), "openlime", tmp_path, "blender", None)
    assert found["warnings"][0].startswith("coat_weight, coat_roughness: this format has no place for them")
    assert "warnings" not in formats.export(result_of("principled"), "openlime", tmp_path, "blender", None)


def test_an_unknown_shaders_normal_and_height_follow_the_convention(tmp_path):
    made = result_of("principled")
    model = replace(made.maps.model, material={"shader": "images"})
    height = Height(np.linspace(-2, 3, 560, dtype=np.float32).reshape(SHAPE), np.ones(SHAPE, bool), "texels")
    result = Result("leaf", replace(made.maps, model=model), height)
    found = textures.write_textures(result, tmp_path, "unreal")
    assert {f"T_leaf_{n}.png" for n in ("N", "H", "AO", "BaseColor", "Roughness", "Specular")} == set(found["files"])
    green = picture(tmp_path / "T_leaf_N.png")[..., 1] * 2 - 1
    np.testing.assert_allclose(green, -made.maps.values["normal"][..., 1], atol=5e-5)


def test_unitys_mask_map_holds_smoothness_in_alpha_and_the_specular_level_is_a_file_of_its_own(tmp_path):
    result = result_of("principled")
    textures.write_textures(result, tmp_path, "unity")
    mask = picture(tmp_path / "leaf_MaskMap.png")
    np.testing.assert_allclose(mask[..., 3], 1 - result.maps.values["roughness"][..., 0], atol=0.51 / 255)
    assert (mask[..., 0] == 0).all() and (mask[..., 1] == 1).all()
    shown = picture(tmp_path / "leaf_Specular.png")[..., :1]
    np.testing.assert_allclose(shown, result.maps.values["specular"], atol=0.51 / 255)


def test_udim_tiles_are_files_of_their_own(tmp_path):
    result = result_of("principled", shape=(16, 32), tiles=(1001, 1012))
    found = textures.write_textures(result, tmp_path)
    assert {"leaf_BaseColor.1001.png", "leaf_BaseColor.1012.png"} <= set(found["files"])
    second = picture(tmp_path / "leaf_Roughness.1012.png")[..., :1]
    np.testing.assert_allclose(second, result.maps.values["roughness"][:, 16:], atol=0.51 / 255)


# --- OpenLIME -------------------------------------------------------------------------------------------------------


def openlime_radiance(folder, light):
    """Return (H, W, 3) what OpenLIME's shader computes before its gamma, by the formulas of its ShaderBRDF."""
    info = json.loads((folder / "info.json").read_text())
    kd, ks, normals, gloss = (picture(folder / info["channels"][c]) for c in ("kd", "ks", "normals", "gloss"))
    assert info["colorspaces"] == {"kd": "srgb", "ks": "srgb"}
    n = normals[..., :3] * 2.0 - 1
    length = np.linalg.norm(n, axis=-1, keepdims=True)
    n = n / np.maximum(length, 1e-9)
    low, high = info["alphaLimits"]
    least, most = 1 - high**0.25, 1 - low**0.25
    alpha = (1 - gloss[..., 0] * (most - least) - least) ** 4
    half = oracles.unit(light + np.array([0, 0, 1.0]))
    nl, nv, nh = n @ light, n[..., 2], n @ half
    ward = np.exp(-(np.tan(np.arccos(np.clip(nh, -1, 1))) ** 2) / alpha**2)
    ward = ward / (4 * np.pi * alpha**2 * np.sqrt(np.maximum(nl * nv, 1e-9)))
    diffuse = unsrgb(kd[..., :3]) / np.pi
    shaded = (diffuse + unsrgb(ks[..., :3]) * ward[..., None]) * np.maximum(nl, 0)[..., None]
    shaded += diffuse * (info.get("kAmbient", 0.1) or 0.02)  # as its LayerBRDF and ShaderBRDF read a missing one, and 0
    return np.where(length < 0.5, 0, shaded * info["brightness"])


@pytest.mark.parametrize(
    ("name", "bound"),
    [("cook_torrance_two_lobe", 0.06), ("principled", 0.06), ("metallic_roughness", 0.08), ("lambert", 0.02)],
)
def test_openlimes_layer_looks_like_the_material(name, bound, tmp_path):
    result = result_of(name)
    found = openlime.write_openlime(result, tmp_path / "layer")
    values = {k: v[..., 0] if v.shape[-1] == 1 else v for k, v in result.maps.values.items()}
    lights = cli_maker.dome_lights(24, widest=65)
    shown = np.stack([openlime_radiance(tmp_path / "layer", light) for light in lights])
    truth = cli_maker.render_oracle(name, values, lights)
    error = np.sqrt(((shown - truth) ** 2).mean() / (truth**2).mean())
    print(f"\n{name} in OpenLIME: {100 * error:.2f} % RMS of the radiance; lobe {found['info']['ward_error']['mean']}")
    assert error < bound


def test_openlimes_layer_says_where_its_highlights_are_too_dark(tmp_path):
    """A quarter of the texels are a bright metal, tilted by 65°."""
    model, shape = load_model("metallic_roughness"), (4, 4)
    metal = np.zeros((*shape, 1), np.float32)
    metal[0] = 1
    tilt = np.radians(65) * metal
    values = {p.name: np.full((*shape, p.components), 0.5, np.float32) for p in model.parameters}
    normal = np.concatenate([np.sin(tilt), 0 * tilt, np.cos(tilt)], axis=-1)
    values |= {"normal": normal, "metallic": metal, "base_color": np.full((*shape, 3), 0.9, np.float32)}
    found = openlime.write_openlime(Result("leaf", Maps(model, values, np.ones(shape, bool))), tmp_path)
    assert found["warnings"] == ["info: the highlight of 25.00% of the texels is too dark: ks holds at most 1"]


def test_uncovered_texels_are_transparent_in_openlime(tmp_path):
    covered = np.ones(SHAPE, bool)
    covered[:4] = False
    openlime.write_openlime(result_of("principled", covered=covered), tmp_path)
    length = np.linalg.norm(picture(tmp_path / "normals.png")[..., :3] * 2 - 1, axis=-1)
    assert (length[:4] < 0.5).all() and (length[4:] > 0.9).all()


# --- PTM ------------------------------------------------------------------------------------------------------------


def read_ptm(path):
    """Return coefficients (H, W, 3, 6), row 0 at the bottom, by Malzbender & Gelb 2001."""
    data = path.read_bytes()
    lines, at = [], 0
    while len(lines) < 6:
        end = data.index(b"\n", at)
        lines.append(data[at:end].decode("ascii"))
        at = end + 1
    assert lines[:2] == ["PTM_1.2", "PTM_FORMAT_RGB"]
    width, height = int(lines[2]), int(lines[3])
    scale, bias = np.array(lines[4].split(), float), np.array([int(word) for word in lines[5].split()])
    assert len(data) - at == 18 * width * height
    found = np.zeros((height, width, 3, 6))
    for channel in range(3):
        for y in range(height):
            for x in range(width):
                place = at + 6 * (width * height * channel + width * y + x)
                found[y, x, channel] = (np.frombuffer(data, np.uint8, 6, place) - bias) * scale
    return found


def test_a_ptm_relights_the_material_under_unseen_lights(tmp_path):
    covered = np.ones(SHAPE, bool)
    covered[:, :3] = False
    result = result_of("lambert", covered=covered, tilt=15)
    report = ptm.write_ptm(result, tmp_path / "leaf.ptm")
    coefficients = read_ptm(tmp_path / "leaf.ptm")
    lights = cli_maker.dome_lights(7, widest=50)
    shown = np.stack([coefficients @ [u * u, v * v, u * v, u, v, 1] for u, v, _ in lights])
    truth = 255 * srgb(cli_maker.render_oracle("lambert", result.maps.values, lights))
    psnr = 10 * np.log10(255**2 / ((np.clip(shown, 0, 255) - truth)[:, covered] ** 2).mean())
    print(f"\nPTM of lambert: {psnr:.1f} dB under other lights, fit {report['leaf.ptm']}")
    assert psnr > 30
    assert np.abs(shown[:, ~covered]).max() < 3


def test_ptm_coefficients_are_least_squares_up_to_quantisation(tmp_path):
    result = result_of("principled")
    ptm.write_ptm(result, tmp_path / "leaf.ptm")
    found = read_ptm(tmp_path / "leaf.ptm")
    lights = ptm.even_lights(64, 80.0)
    values = {k: v[..., 0] if v.shape[-1] == 1 else v for k, v in result.maps.values.items()}
    pictures = 255 * srgb(cli_maker.render_oracle("principled", values, lights))
    terms = np.stack([[u * u, v * v, u * v, u, v, 1] for u, v, _ in lights])
    truth, *_ = np.linalg.lstsq(terms, pictures.reshape(64, -1), rcond=None)
    truth = np.moveaxis(truth.reshape(6, *SHAPE, 3), 0, -1)
    step = np.ptp(truth, axis=(0, 1, 2)) / 254
    assert (np.abs(found - truth).max(axis=(0, 1, 2)) < 0.51 * step + 0.02).all()


# --- the command ----------------------------------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path):
    """A result's folder with material.blend."""
    result, obj = on_a_sheet("principled", texels=48)
    report = {"model": "principled", "settings": {"model": "principled"}}
    height = Height(result.maps.values["specular"][..., 0], result.maps.solved, "world")
    write_maps(result.maps, tmp_path / "leaf", report | {"height": height.described()}, None, [height_map(height)])
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "leaf" / "material.blend"), copy=True)
    return tmp_path / "leaf"


def test_a_result_folder_reads_back_as_written(folder):
    found = read_result(folder)
    assert found.name == "leaf" and found.blend == folder / "material.blend" and found.height.unit == "world"
    assert found.maps.solved.any() and not found.maps.solved.all()


@pytest.mark.parametrize(
    ("kind", "files"),
    [
        ("gltf", {"leaf.glb"}), ("ptm", {"leaf.ptm"}),
        ("openlime", {"kd.png", "ks.png", "normals.png", "gloss.png", "info.json"}),
        ("textures", {"T_leaf_BC.png", "T_leaf_N.png", "T_leaf_ORM.png", "T_leaf_S.png", "T_leaf_H.png"}),
    ],
)  # fmt: skip
def test_the_command_writes_each_format(kind, files, folder, tmp_path):
    convention = ["--convention", "unreal"] if kind == "textures" else []
    code, out, err = run_cli("export", folder, "--format", kind, *convention, "-o", tmp_path / "out", "--json")
    assert (code, err) == (0, "") and str(tmp_path / "out") in json.loads(out.splitlines()[-1])["output"]
    assert {path.name for path in (tmp_path / "out").iterdir()} == files


@pytest.mark.parametrize(
    ("kind", "option"),
    [
        ("gltf", ("--convention", "unreal")), ("ptm", ("--photographs", "4")), ("gltf", ("--width", "5")),
        ("ptm", ("--object", "leaf")), ("textures", ("--object", "leaf")),
    ],
)  # fmt: skip
def test_an_option_of_another_format_is_refused(kind, option, folder, tmp_path):
    code, _, err = run_cli("export", folder, "--format", kind, *option, "-o", tmp_path / "out")
    assert code == 2 and f"{option[0]}: --format {kind} has none" in err and not (tmp_path / "out").exists()


def test_a_file_can_be_named(folder, tmp_path):
    code, _, err = run_cli("export", folder, "--format", "gltf", "-o", tmp_path / "mine.GLB", "--quiet")
    assert (code, err) == (0, "") and read_glb(tmp_path / "mine.glb")[0]["asset"]["version"] == "2.0"
    code, _, err = run_cli("export", folder, "--format", "gltf", "-o", tmp_path / "mine.GLB", "--quiet")
    assert code == 2 and "mine.glb: is there already" in err


@pytest.mark.parametrize(
    ("kind", "out", "mine"),
    [
        ("textures", "set", "set/{}_Normal.png"),
        ("openlime", "layer", "layer/info.json"),
        ("gltf", "a.glb", "a.glb"),
        ("ptm", "a.ptm", "a.ptm"),
        ("turntable", "a.png", "a.png"),
    ],
)
def test_a_file_of_the_users_own_is_replaced_only_on_request(kind, out, mine, folder, tmp_path):
    mine = tmp_path / mine.format(folder.name)
    mine.parent.mkdir(exist_ok=True)
    mine.write_text("mine")
    beside = set(mine.parent.iterdir())
    words = ("export", folder, "--format", kind, "-o", tmp_path / out)
    code, _, said = run_cli(*words)
    assert code == 2 and said == f"irpso: {mine}: is there already; choose another -o, or replace it with --replace\n"
    assert mine.read_text() == "mine" and set(mine.parent.iterdir()) == beside
    assert run_cli(*words, "--replace")[0] == 0
    assert mine.read_bytes() != b"mine"


def test_unexportable_results_are_refused_in_one_line_with_nothing_written(folder, tmp_path):
    out = tmp_path / "out"

    def refused(*options, out=out):
        code, _, err = run_cli("export", *options, "-o", out)
        assert code == 2 and err.count("\n") == 1 and not out.exists()
        return err

    for kind, name, remedy in (
        ("gltf", "a.gltf", "name a .glb file, or a folder"),
        ("web", "a.html", "name a folder"),
        ("turntable", "a.jpg", "name a .png file, or a folder"),
    ):
        assert f"{name}: this format writes no" in (said := refused(folder, "--format", kind, out=tmp_path / name))
        assert said.endswith(f"; {remedy}\n")
    assert "--tag: is of an asset; export with --format asset" in refused(folder, "--format", "ptm", "--tag", "a")
    assert "holds no report.json" in refused(tmp_path, "--format", "ptm")
    assert "normal.exr: is a file; give the folder" in refused(folder / "normal.exr", "--format", "ptm")
    (tmp_path / "report.json").write_text('{"kind": "mirror", "lights": []}')
    assert "holds no result of recover" in refused(tmp_path, "--format", "ptm")
    (tmp_path / "report.json").write_text('{"texels": 3, "slots": {"Skin": {}, "Eyes": {}}}')
    assert f"give one of their folders: '{tmp_path / 'Skin'}'" in refused(tmp_path, "--format", "ptm")
    assert "no such mesh; it has 'sheet'" in refused(folder, "--format", "gltf", "--object", "cube")
    (folder / "material.blend").unlink()
    assert "holds no material.blend" in refused(folder, "--format", "gltf")
    own = cli_maker.MODELS / "two_colours.toml"
    if own.exists():
        assert "is not known" in refused(folder, "--format", "openlime", "--model", own)


def test_a_model_of_the_users_is_found_from_any_folder_and_refused_once_it_has_changed(tmp_path, monkeypatch):
    lights = cli_maker.dome_lights(8, widest=60)
    images = cli_maker.render_oracle("lambert", cli_maker.smooth_maps((7, 9), {}, seed=3), lights)
    here, there = tmp_path / "here", tmp_path / "there"
    cli_maker.write_card(here / "leaf", images, lights)
    there.mkdir()
    for kind in ("toml", "glsl"):
        shutil.copy(MODELS / f"lambert.{kind}", here / f"my.{kind}")
    (there / "my.toml").write_text("another model")
    monkeypatch.chdir(here)
    words = ["recover", "leaf", "--model", "my.toml", "--preset", "swarm", "--iterations", 2, "-o", "out", "--quiet"]
    assert run_cli(*words)[0] == 0
    monkeypatch.chdir(there)
    export = ["export", here / "out", "--format", "textures", "--quiet", "-o"]
    code, _, err = run_cli(*export, there / "first")
    assert (code, err) == (0, "")
    with (here / "my.toml").open("a") as file:
        file.write("\n# changed\n")
    code, _, err = run_cli(*export, there / "second")
    assert code == 2 and "my.toml: has changed since this recovery" in err and "--model" in err
    assert run_cli(*export, there / "second", "--model", here / "my.toml")[0] == 0


def test_an_unknown_normal_map_is_refused_before_anything_is_read(tmp_path):
    code, _, err = run_cli("recover", tmp_path, "--normals", "object,tangant", "-o", tmp_path / "out")
    assert code == 2 and "'tangant' is not a normal map; choose some of object, world, directx" in err


def test_recover_writes_the_requested_exports(tmp_path):
    lights = cli_maker.dome_lights(12, widest=60)
    values = cli_maker.smooth_maps(SHAPE, {}, seed=3)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    truth = 1.5 * np.sin(0.3 * x + 0.1 * y)
    slope = 1.5 * np.cos(0.3 * x + 0.1 * y)
    values["normal"] = oracles.unit(np.stack([-0.3 * slope, -0.1 * slope, np.ones(SHAPE)], axis=-1))
    cli_maker.write_card(tmp_path / "leaf", cli_maker.render_oracle("lambert", values, lights), lights)
    code, _, err = run_cli(
        "recover", tmp_path / "leaf", "--model", "lambert", "--normals", "directx,object", "--displacement",
        "--iterations", 40, "-o", tmp_path / "out", "--quiet",
    )  # fmt: skip
    assert (code, err) == (0, "")
    found = read_result(tmp_path / "out")
    green = picture(tmp_path / "out" / "normal_directx.png")[..., 1] * 2 - 1
    np.testing.assert_allclose(green, -found.maps.values["normal"][..., 1], atol=5e-5)
    described = json.loads((tmp_path / "out" / "report.json").read_text())["height"]
    assert described["unit"] == "texels"
    heights = (picture(tmp_path / "out" / "height.png")[..., 0] - described["midlevel"]) * described["scale"]
    assert np.abs(heights - heights.mean() - truth + truth.mean()).max() < 0.05
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "out" / "material.blend"))
    (material,) = bpy.data.materials
    assert material.displacement_method == "BOTH" and "IRPSO displacement" in material.node_tree.nodes
