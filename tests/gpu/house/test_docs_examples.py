"""The examples of the guide do what it says they do."""

import contextlib
import io
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from irpso_addon import Recovery, domain_from_card, load_model, load_schedule
from irpso_addon.capture.camera import Camera
from irpso_addon.capture.types import Capture, Light, Observation
from tests.builders import command_line as cli_maker
from tests.builders.command_line import angle, read_map
from tests.builders.model_probe import evaluate
from tests.oracles import reflectance as oracles

pytestmark = pytest.mark.usefixtures("gpu")

DOCS = Path(__file__).resolve().parents[3] / "docs"


def blocks(page, language):
    """The examples of a page in one language, in order."""
    text = (DOCS / page).read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


@pytest.fixture
def dust(tmp_path):
    """The model of writing_a_model.md."""
    for kind in ("glsl", "toml"):
        (tmp_path / f"dust.{kind}").write_text(blocks("writing_a_model.md", kind)[0], encoding="utf-8")
    return load_model(tmp_path / "dust.toml")


def minnaert(values, light, view):
    """base_color (n·l)^k (n·v)^(k − 1), where both are seen (Minnaert 1941)."""
    up, toward = oracles.dot(values["normal"], light), oracles.dot(values["normal"], view)
    k, seen = np.reshape(values["k"], np.shape(up)), (up > 1e-7) & (toward > 1e-7)
    up, toward = np.where(seen, up, 1), np.where(seen, toward, 1)
    return values["base_color"] * np.where(seen, up**k * toward ** (k - 1), 0)[..., None]


def test_the_model_of_the_guide_is_the_formula_above_it(dust, root):
    rng = np.random.default_rng(2)
    normal, light, view = (oracles.unit(rng.normal(size=(3000, 3)) + (0, 0, 1)) for _ in range(3))
    values = {"base_color": rng.random((3000, 3)), "normal": normal, "k": rng.uniform(0.5, 1.5, 3000)}
    got = evaluate(root, dust, values, light, view)
    steep = np.minimum(np.abs(oracles.dot(normal, light)), np.abs(oracles.dot(normal, view))) < 0.01
    assert np.isfinite(got).all() and (got > 0).mean() > 0.3
    assert np.allclose(got[~steep], minnaert(values, light, view)[~steep], rtol=2e-4, atol=1e-6)


def test_the_model_of_the_guide_is_recovered_from_photographs_of_it(dust):
    shape, lights = (24, 32), cli_maker.dome_lights(30, widest=70)
    truth = cli_maker.smooth_maps(shape, {"k": (0.6, 1.4)}, seed=5, tilt=40)
    images = [minnaert(truth, light, np.array([0, 0, 1.0])) for light in lights]
    ones = np.ones(shape)
    observations = tuple(
        Observation(str(k), lambda image=image: np.float32(np.dstack([image, ones])), Light(tuple(light)))
        for k, (image, light) in enumerate(zip(images, lights, strict=True))
    )
    camera = Camera.orthographic(shape[1], shape[0], 2.0)
    domain = domain_from_card(Capture("card", observations, (camera,), (ones > 0,)))
    with Recovery(domain, dust, load_schedule("standard"), seed=1) as recovery:
        recovery.step()
        maps = recovery.maps(confidence=False)
    assert angle(maps.values["normal"], truth["normal"]).mean() < 0.1
    assert np.abs(maps.values["k"][..., 0] - truth["k"]).mean() < 0.01


def test_arrays_in_and_out_recovers_the_ball(tmp_path):
    example, said = blocks("scripting.md", "python")[1], io.StringIO()
    names = {}
    with contextlib.redirect_stdout(said):
        exec(example, names)
    assert re.match(r"normals are 0\.\d{3}° off on average, base colour \[0\.", said.getvalue())
    inside = names["mask"]
    assert angle(names["maps"].values["normal"], names["truth"])[inside].mean() < 0.1
    assert np.allclose(names["maps"].values["base_color"][inside].mean(axis=0), (0.7, 0.4, 0.2), atol=0.002)


def test_files_in_and_out_recovers_a_folder(tmp_path, monkeypatch):
    truth = cli_maker.smooth_maps((16, 20), {"roughness": (0.3, 0.6), "specular": (0.4, 0.7)}, seed=4)
    lights = cli_maker.dome_lights(24, widest=70)
    cli_maker.write_card(tmp_path / "my_capture", cli_maker.render_oracle("principled", truth, lights), lights)
    monkeypatch.chdir(tmp_path)
    with contextlib.redirect_stdout(io.StringIO()) as said:
        exec(blocks("scripting.md", "python")[0], {})
    assert "% " in said.getvalue()
    normal = read_map(tmp_path / "out" / "normal.exr")
    assert angle(normal, truth["normal"]).mean() < 0.5


def test_the_script_for_the_background_recovers_and_keeps(tmp_path):
    example = next(code for code in blocks("scripting.md", "python") if "bpy.ops.irpso" in code)
    truth = cli_maker.smooth_maps((16, 20), {"roughness": (0.3, 0.6), "specular": (0.4, 0.7)}, seed=4)
    lights = cli_maker.dome_lights(24, widest=70)
    cli_maker.write_card(tmp_path / "icon", cli_maker.render_oracle("principled", truth, lights), lights)
    before = "import bpy, irpso_addon\nbpy.ops.wm.read_homefile(use_empty=True)\nirpso_addon.register()\n"
    after = (
        "\nimport os\nimage = next(i for i in bpy.data.images if 'normal' in i.name)\n"
        "print('TOLD', len(bpy.data.materials), *image.size, bpy.data.filepath, flush=True)\n"
        "os._exit(0) if bpy.app.version < (5, 0) else None  # these wheels do not survive Python's end\n"
    )
    code = before + example.replace("/captures", str(tmp_path)) + after
    done = subprocess.run([sys.executable, "-c", code], cwd=DOCS.parent, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0
    assert f"TOLD 1 20 16 {tmp_path}/icon.blend" in done.stdout, done.stdout + done.stderr
    assert (tmp_path / "icon.blend").is_file()
