"""``recover`` with rounds of interreflection, as a user asks for them: a hollow card, and what cannot have them."""

import json
import os
import re

import numpy as np
import pytest

from irpso_addon.solver.engine.tiled import TiledRecovery
from irpso_addon.solver.views import pictures
from tests.builders.cavity import cap_card
from tests.builders.command_line import angle, dome_lights, read_map, run_cli, write_card

ALBEDO = (0.8, 0.6, 0.4)
LIGHTS = dome_lights(24, 50.0)
SMALL = "interreflection_rounds=2", "interreflection_resolution=20", "interreflection_rays=16"


@pytest.fixture(scope="module")
def card(tmp_path_factory):
    """(capture of a hollow cap, its normals, its mask, and what its photographs (K, H, W) show)."""
    domain, _, normals = cap_card(ALBEDO, LIGHTS)
    images = domain.stack.values[..., :3].astype(np.float64)
    folder = tmp_path_factory.mktemp("cap") / "cap"
    return write_card(folder, images, LIGHTS, domain.solvable), normals, domain.solvable, images.mean(axis=-1)


def recover(capture, out, *more):
    code, printed, _ = run_cli("recover", capture, "--model", "lambert", "-o", out, "--json", *more)
    return code, json.loads(printed.splitlines()[-1])


def test_rounds_lower_the_error_of_a_hollow_card_and_report_their_strength(card, tmp_path):
    capture, normals, mask, light = card
    tilt = {}
    for rounds in (0, 2):
        out = tmp_path / str(rounds)
        code, report = recover(capture, out, "--set", f"interreflection_rounds={rounds}")
        assert code == 0
        tilt[rounds] = angle(read_map(out / "normal.exr"), normals)[mask].mean()
    assert tilt[2] < tilt[0] / 3
    found = report["interreflection"]
    assert found["rounds"] == 2 and 0.8 < found["strength"][-1] < 1.3
    assert (tmp_path / "2" / "indirect.png").exists() and not (tmp_path / "0" / "indirect.png").exists()
    share, rho = read_map(tmp_path / "2" / "indirect.exr")[..., 0], np.array(ALBEDO)
    sent = (rho * 0.25 * rho / (1 - 0.25 * rho)).mean() * 0.75 * LIGHTS[:, 2].sum()  # as cap_card has it
    off = share[mask] / (sent / light.sum(axis=0)[mask]) - 1
    assert abs(off).mean() < 0.1 and abs(off).max() < 0.35  # the relief ends at the rim
    assert found["share"] == pytest.approx(share[mask].mean(), rel=1e-4)


def test_photographs_that_are_held_out_are_relit_with_the_light_of_the_rounds(card, tmp_path):
    capture, *_ = card
    found = {}
    for rounds in (0, 2):
        settings = "--set", f"interreflection_rounds={rounds}", "--hold-out", "3,17"
        code, report = recover(capture, tmp_path / str(rounds), *settings)
        assert code == 0
        found[rounds] = report["relighting_mean_psnr_db"]
    assert found[2] > found[0] + 1


def test_an_interrupted_run_resumes_to_the_same_maps(card, tmp_path):
    from irpso_addon.pipeline import drive

    capture, *_ = card
    settings = "--set", "interreflection_rounds=1"
    assert recover(capture, tmp_path / "whole", *settings)[0] == 0
    looks = iter([False] * 12 + [True] * 100)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(drive, "_MAX_ITERATIONS", 4)
        patch.setattr(drive, "delayed_signals", lambda: _Interrupted(looks))
        assert run_cli("recover", capture, "--model", "lambert", "-o", tmp_path / "cut", *settings)[0] == 130
    assert recover(capture, tmp_path / "cut", *settings, "--resume")[0] == 0
    for name in ("maps.exr", "normal.exr", "confidence.exr"):
        assert (tmp_path / "cut" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


@pytest.mark.parametrize("memory", ["device=2M", "device=2M,host=517M"])
def test_no_file_of_the_result_depends_on_the_memory(card, tmp_path, monkeypatch, memory):
    settings = "--hold-out", 1, *(part for text in SMALL for part in ("--set", text))
    allowed = {"whole": (), "tiles": ("--memory", memory)}
    assert recover(card[0], tmp_path / "whole", *settings)[0] == 0
    plan = recover(card[0], tmp_path / "tiles", *settings, "--dry-run", *allowed["tiles"])[1]["plan"]
    assert len(plan["tiles"]) > 1 and not plan["resident"]
    assert (plan["stack_on"] == "scratch") == ("host" in memory)
    steps, step = [], TiledRecovery.step
    monkeypatch.setattr(TiledRecovery, "step", lambda self, *given: steps.append(None) or step(self, *given))
    code, report = recover(card[0], tmp_path / "tiles", *settings, *allowed["tiles"])
    assert code == 0 and report["interreflection"]["rounds"] == 2 and steps
    names = [name for name in os.listdir(tmp_path / "whole") if name.endswith((".exr", ".png"))]
    for name in names:
        assert (tmp_path / "tiles" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes(), name
    assert {"maps.exr", "normal.exr", "confidence.exr", "convergence.png", "preview.png"} <= set(names)


class _Interrupted:
    """What ``delayed_signals`` returns: a signal comes when the looks say so."""

    def __init__(self, looks):
        self._looks = looks

    def __enter__(self):
        return lambda: next(self._looks)

    def __exit__(self, *_):
        return None


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (("--set", "levels=2"), "set levels = 1"),
        (("--set", "interreflection_rays=1024", "--memory", "device=8M"), "lower .* or interreflection_rays"),
    ],
)
def test_what_cannot_have_rounds_is_refused_before_anything_is_written(card, tmp_path, more, said):
    code, printed = recover(card[0], tmp_path / "out", "--set", "interreflection_rounds=1", *more)
    assert code == 2 and re.search(said, printed["error"])
    assert not (tmp_path / "out").exists()


def test_the_preview_renders_what_the_photographs_show(card, tmp_path):
    # Without the light that was taken off, the renders of the better maps would be too dark by 10 %.
    from irpso_addon.pipeline import result

    shown = {}
    with pytest.MonkeyPatch.context() as patch:
        kept = result.error_preview

        def preview(domain, maps, truth, names, indirect):
            rows = pictures.image_rows(domain, maps, range(len(names)), names, indirect)
            shown["error"] = np.mean([row.error[row.compared].mean() for row in rows])
            return kept(domain, maps, truth, names, indirect)

        patch.setattr(result, "error_preview", preview)
        assert recover(card[0], tmp_path / "out", "--set", "interreflection_rounds=2")[0] == 0
    assert shown["error"] < 1.5  # % of white
