"""``recover`` through the public command: its files, its report, models of one's own."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import OpenEXR
import pytest

from irpso_addon.capture.camera import Camera
from irpso_addon.commands.recover import _summary
from irpso_addon.geometry.domain import with_samples
from irpso_addon.pipeline.result import _oblong_warnings, _overexposed_warnings
from tests.builders import command_line as cli_maker
from tests.builders.command_line import MODELS, angle, read_map, run_cli
from tests.builders.domains import make_domain
from tests.builders.recovered import FILES, LIGHTS, OTHERS, OWN, SHAPE, recovered_models

recovered = pytest.fixture(recovered_models, scope="module")


@pytest.mark.parametrize("name", FILES)
def test_a_result_holds_exactly_its_files(name, recovered):
    _, out, _ = recovered(name)
    pictures = {f"{stem}.{kind}" for stem in FILES[name] for kind in ("png", "exr")}
    assert {path.name for path in out.iterdir()} == pictures | OTHERS
    with OpenEXR.File(str(out / "maps.exr"), separate_channels=True) as file:
        parts = {part.name() for part in file.parts}
    assert parts >= FILES[name] | {"residual", "coverage", "confidence_normal"}
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert set(report["files"]) == (pictures | OTHERS) - {"material.blend"}
    assert report["settings"]["model"] == name and report["seed"] == 5 and report["texels"] == SHAPE[0] * SHAPE[1]
    assert report["evaluations"] > 0 and {"read", "prepare", "solve"} <= set(report["seconds"])
    assert report["versions"]["blender"] and report["gpu"]


def top_row_first(path):
    """Return an EXR's pixels in the order of the file, by OpenEXR alone."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = file.channels()
        return np.stack([channels[c].pixels for c in "RGBY" if c in channels], axis=-1)


def test_maps_lie_pixel_for_pixel_on_the_images_top_row_first(recovered):
    values, out, _ = recovered("lambert")
    image = top_row_first(out.parent / "lambert" / "000.exr")
    normal = values["normal"][::-1]
    # The files' own rows: radiance over cosine is the albedo, by the equation of Lambert alone.
    expected = image / (normal @ LIGHTS[0])[..., None]
    np.testing.assert_allclose(top_row_first(out / "base_color.exr"), expected, atol=2e-3)
    found = angle(top_row_first(out / "normal.exr"), normal)
    assert found.max() < 0.1
    # Turned in any way it would be far off.
    for other in (normal[::-1], normal[:, ::-1], normal[::-1, ::-1]):
        assert angle(top_row_first(out / "normal.exr"), other).max() > 10


def test_png_maps_hold_what_the_exr_maps_hold(recovered):
    import bpy

    values, out, _ = recovered("principled")
    for name, decode, tolerance in (
        ("normal", lambda v: v * 2 - 1, 3e-3),
        ("roughness", lambda v: v[..., :1], 2e-5),
        ("base_color", lambda v: np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4), 5e-5),
    ):
        image = bpy.data.images.load(str(out / f"{name}.png"))
        image.colorspace_settings.name = "Non-Color"
        pixels = np.empty(SHAPE[0] * SHAPE[1] * image.channels, np.float32)
        image.pixels.foreach_get(pixels)
        bpy.data.images.remove(image)
        found = decode(pixels.reshape(*SHAPE, -1)[..., :3])
        np.testing.assert_allclose(found, read_map(out / f"{name}.exr"), atol=tolerance)


# Largest allowed errors: normal (mean, 99th percentile) in degrees; then each scalar's mean in per cent of its range.
BOUNDS = {
    "lambert": (0.01, 0.05, {}),
    "principled": (0.25, 1.5, {"roughness": 2.0, "specular": 5.0}),
    "cook_torrance_two_lobe": (0.1, 0.4, {"r1": 1.0, "r2": 7.0, "w": 5.0}),
    "ward": (0.1, 0.4, {"strength": 1.5, "slope": 1.0}),
    "oren_nayar": (0.1, 0.4, {"sigma": 1.0}),
}


@pytest.mark.parametrize("name", BOUNDS)
def test_a_material_is_recovered_from_its_images(name, recovered):
    from irpso_addon.reflectance.model import load_model
    from irpso_addon.results.read import read_maps

    values, out, answer = recovered(name)
    model = load_model(MODELS / f"{name}.toml" if name in OWN else name)
    found = read_maps(out, model)
    normal = angle(found["normal"], values["normal"])
    mean, worst, scalars = BOUNDS[name]
    color = 100 * np.abs(found["base_color"] - values["base_color"]).mean()
    text = f"normal {normal.mean():.4f}° (99 %: {np.percentile(normal, 99):.3f}°), base_color {color:.3f} %"
    errors = {}
    for scalar in scalars:
        low, high = model.parameter(scalar).range
        errors[scalar] = 100 * np.abs(found[scalar][..., 0] - values[scalar]).mean() / (high - low)
        text += f", {scalar} {errors[scalar]:.3f} %"
    print(f"\n{name}: {text}; residual {answer['residual']['mean']:.2e}; solved in {answer['seconds']['solve']:.1f} s")
    assert normal.mean() < mean and np.percentile(normal, 99) < worst and color < 0.5
    assert all(errors[scalar] < bound for scalar, bound in scalars.items())


def srgb(linear):
    """IEC 61966-2-1, of what fits 0 to 1."""
    linear = np.clip(linear, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def test_the_report_measures_errors_against_ground_truth(recovered, tmp_path):
    values, out, _ = recovered("lambert")
    truth = out / "normal.exr"
    code, answer, _ = run_cli(
        "recover", out.parent / "lambert", "--model", "lambert", "--preset", "swarm", "--iterations", 30,
        "--set", "start=random", "--ground-truth", truth,
        "--hold-out", "light 3,7", "-o", tmp_path / "out", "--json",
    )  # fmt: skip
    answer = json.loads(answer.splitlines()[-1])
    expected = angle(read_map(tmp_path / "out" / "normal.exr"), read_map(truth))
    assert code == 0
    assert expected.mean() > 0.01
    assert answer["ground_truth"]["normal"]["mean"] == pytest.approx(expected.mean(), rel=1e-3)
    assert answer["ground_truth"]["normal"]["p99"] == pytest.approx(np.percentile(expected, 99), rel=1e-3)
    assert answer["held_out"] == [3, 7]
    assert set(answer["relighting_psnr_db"]) == {"light 3", "light 7"} and (tmp_path / "out" / "relit.png").is_file()
    found = {name: read_map(tmp_path / "out" / f"{name}.exr") for name in ("normal", "base_color")}
    seen, relit = (cli_maker.render_oracle("lambert", maps, LIGHTS[3:4])[0] for maps in (values, found))
    white = np.percentile(seen, 99.5)
    difference = srgb(seen / white) - srgb(relit / white)
    assert answer["relighting_psnr_db"]["light 3"] == pytest.approx(-10 * np.log10((difference**2).mean()), abs=0.05)


def test_a_prior_decides_nothing_about_what_is_not_searched(tmp_path):
    lights = cli_maker.dome_lights(6, widest=30)
    images = cli_maker.render_oracle("lambert", cli_maker.smooth_maps((6, 8), {}), lights)
    folder = cli_maker.write_card(tmp_path / "matt", images, lights)
    words = "recover", folder, "--model", "metallic_roughness", "--iterations", 3, "--json"
    shares = []
    for number, more in enumerate(((), ("--search", "normal,base_color,roughness"))):
        code, answer, err = run_cli(*words, *more, "-o", tmp_path / f"out{number}")
        assert code == 0, err
        shares.append(set(json.loads(answer.splitlines()[-1])["priors_decided"]))
    assert shares[0] == shares[1] | {"metallic", "specular"} and shares[1] == {"roughness"}


def test_highlights_of_held_out_images_are_measured_separately(tmp_path):
    lights = cli_maker.dome_lights(20, widest=30)
    values = cli_maker.smooth_maps((24, 30), {"roughness": (0.3, 0.4), "specular": (1.0, 1.0)})
    images = cli_maker.render_oracle("principled", values, lights)
    folder = cli_maker.write_card(tmp_path / "shiny", images, lights)
    out = tmp_path / "out"
    # Matt by order: what it relights lacks all highlights.
    code, answer, _ = run_cli(
        "recover", folder, "--fixed", "specular=0", "--fixed", "roughness=1", "--hold-out", "auto", "-o", out, "--json"
    )
    answer = json.loads(answer.splitlines()[-1])
    assert code == 0
    names, shown = ["light 4", "light 12"], 0
    assert list(answer["relighting_psnr_db"]) == list(answer["relighting_highlights_psnr_db"]) == names
    found = {"normal": read_map(out / "normal.exr"), "base_color": read_map(out / "base_color.exr")}
    for name, light, image in zip(names, (lights[4], lights[12]), (images[4], images[12]), strict=True):
        matt = cli_maker.render_oracle("lambert", found, [light])[0]
        seen, diffuse = image[..., :3], matt[..., :3]
        white = np.percentile(seen, 99.5)
        bright = seen.mean(axis=-1) > 1.5 * diffuse.mean(axis=-1) + 0.02 * np.percentile(seen.mean(axis=-1), 99.5)
        highlights = answer["relighting_highlights_psnr_db"][name]
        if not bright.any():
            assert highlights is None
            continue
        difference = (srgb(np.clip(seen / white, 0, 1)) - srgb(np.clip(diffuse / white, 0, 1)))[bright]
        expected = -10 * np.log10((difference**2).mean())
        assert highlights == pytest.approx(expected, abs=0.3)
        assert answer["relighting_psnr_db"][name] > expected + 3
        shown += 1
    assert shown


def test_fixed_parameters_are_not_searched(recovered, tmp_path):
    values, out, _ = recovered("principled")
    code, _, _ = run_cli(
        "recover", out.parent / "principled", "--fixed", f"normal={out / 'normal.exr'}", "--fixed", "specular=0.25",
        "--iterations", 20, "-o", tmp_path / "out", "--quiet",
    )  # fmt: skip
    assert code == 0
    np.testing.assert_array_equal(read_map(tmp_path / "out" / "normal.exr"), read_map(out / "normal.exr"))
    np.testing.assert_array_equal(read_map(tmp_path / "out" / "specular.exr"), np.float32(0.25))


@pytest.mark.parametrize("name", ["bunny_lambert_noshadow", "bunny_lambert", "bunny_specular", "rti_icon"])
def test_inspect_finds_no_error_in_real_captures(name, shared_data):
    code, out, err = run_cli("inspect", shared_data / name)
    assert (code, err) == (0, "")
    assert "error:" not in out
    facts = dict(line.split(None, 1) for line in out.splitlines()[:6])
    images, size = ("72", "402×395") if name == "rti_icon" else ("50", "256×256")
    assert facts["images"] == images and facts["lights"] == f"{images} distant, 0 near"
    assert facts["camera"].startswith(size)


def test_doctor_names_the_gpu_its_limits_and_the_choices():
    import bpy
    import gpu

    from irpso_addon.reflectance.model import shipped_models

    code, out, err = run_cli("doctor")
    assert (code, err) == (0, "")
    facts = dict(line.split("  ", 1) for line in out.splitlines())
    facts = {name.strip(): value.strip() for name, value in facts.items()}
    assert facts["version of blender"] == bpy.app.version_string
    assert facts["GPU"] == gpu.platform.renderer_get()
    assert facts["largest texture"].startswith(f"{gpu.capabilities.max_texture_size_get()} texels")
    assert facts["passes used"] in ("fragment", "compute")
    assert facts["models"].split(", ") == shipped_models()
    code, out, _ = run_cli("doctor", "--json")
    assert code == 0 and json.loads(out)["renderer"] == facts["GPU"]


def test_the_summary_gives_errors_in_parts_of_white_and_what_the_photographs_decide():
    report = {
        "texels": 100, "unseen_texels": 0, "seconds": {"solve": 2.0}, "residual": {"mean": 0.00712, "p99": 0.0412},
        "photographs_decided": {"roughness": 0.996, "specular": 0.0}, "relighting_mean_psnr_db": 20.0,
        "relighting_highlights_mean_psnr_db": None, "warnings": [],
    }  # fmt: skip
    lines = _summary(report, Path("out"), 1.0).splitlines()
    assert "fitted photographs: mean error of radiance 0.71% of white, of 99 in 100 texels at most 4.1%" in lines
    assert any(line.startswith("decided by the photographs: roughness on 100%, specular on 0%") for line in lines)
    assert "unseen photographs: RMS error 10.0% (20.0 dB)" in lines
    nothing = report | {"ground_truth": {"normal": {"unit": "°", "mean": None, "median": None, "p99": None}}}
    assert "normal against ground truth: nothing to compare" in _summary(nothing, Path("out"), 1.0)


@pytest.mark.parametrize(("height", "mesh", "warned"), [(1.0, None, True), (2.0, None, False), (1.0, object(), False)])
def test_a_card_of_oblong_pixels_gets_a_warning(height, mesh, warned):
    camera = Camera(10, 10, (5.0, 10 / height), (5.0, 5.0), np.eye(4), False)
    lines = _oblong_warnings(SimpleNamespace(mesh=mesh, capture=SimpleNamespace(cameras=[camera])))
    assert [line[:46] for line in lines] == ["the card's pixels are 2 times as wide as high:"] * warned


@pytest.mark.parametrize(("clipped", "dark", "count"), [(12, 0, 12), (0, 12, 0), (12, 30, 12)])
def test_texels_that_are_clipped_in_every_photograph_get_a_warning(clipped, dark, count):
    """Their samples are lower bounds alone: none is recovered, and the neighbours whose values they get are darker."""
    domain = make_domain(10, 20, holes=False)
    samples = np.stack([*domain.stack.layers()])
    samples[:, 0, :clipped, 3] = -7.5  # all channels, weight 1 (capture/bounds.py)
    samples[:, 2:, :3, :3] = 0
    samples[:, 5].reshape(len(samples), -1, 4)[:, :dark] = 0
    domain = with_samples(domain, samples)
    lines = _overexposed_warnings(domain, SimpleNamespace(solved=domain.solvable))
    assert len(lines) == (count > 0) and (not count or f"about {count} texels are overexposed" in lines[0])
