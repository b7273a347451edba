"""Pictures of a result: what no light told anything of is no part of them."""

import json

import numpy as np
import pytest

from irpso_addon.core.encode import linear_from_srgb
from irpso_addon.core.steps import run_steps
from irpso_addon.geometry.domain import with_samples
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.maps import Maps
from irpso_addon.solver.views import held_out, pictures
from irpso_addon.solver.views.pictures import image_row, image_rows
from tests.builders import command_line as cli_maker
from tests.builders.command_line import run_cli
from tests.builders.domains import make_domain


def test_an_unmasked_black_background_is_left_out_of_relit_pictures(tmp_path):
    lights = cli_maker.dome_lights(14, widest=60)
    values = cli_maker.smooth_maps((20, 26), {}, seed=3)
    images = cli_maker.render_oracle("lambert", values, lights)
    images[:, :, :9] = 0
    capture = cli_maker.write_card(tmp_path / "card", images, lights)
    options = ["--model", "lambert", "--preset", "swarm", "--iterations", 400, "--hold-out", "5", "--quiet"]
    assert run_cli("recover", capture, *options, "-o", tmp_path / "out")[0] == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text(encoding="utf-8"))
    assert report["relighting_psnr_db"]["light 5"] > 35


def first_row(domain):
    """The row of a preview for image 0 of a domain, of the Lambert model's defaults."""
    model = load_model("lambert")
    values = {p.name: np.full((*domain.shape, p.components), p.default, np.float32) for p in model.parameters}
    return image_rows(domain, Maps(model, values, domain.solvable), [0], ["Image 0"])[0]


def test_a_photograph_and_its_render_have_one_exposure():
    domain = make_domain(6, 8, holes=False)
    photograph = domain.stack.layer(0)[..., :3]
    row = image_row(domain, Maps(load_model("lambert"), {}, domain.solvable), 0, "Image 0", photograph / 2)
    shown = domain.solvable & (row.reference < 1).all(axis=-1)
    half = linear_from_srgb(row.reference[shown]) / 2
    assert shown.sum() > 20
    np.testing.assert_allclose(linear_from_srgb(row.recovered[shown]), half, atol=1e-4)


@pytest.mark.parametrize("module", [pictures, held_out])
def test_the_errors_of_all_photographs_have_one_scale(module, monkeypatch):
    domain = make_domain(6, 8, holes=False)
    model = load_model("lambert")
    values = {p.name: np.full((*domain.shape, p.components), p.default, np.float32) for p in model.parameters}
    maps = Maps(model, values, domain.solvable)
    shown = []
    monkeypatch.setattr(module, "preview", lambda rows, _: shown.extend(rows))
    if module is pictures:
        pictures.error_preview(domain, maps, None, [""] * 9)
    else:
        run_steps(held_out.relit_steps(domain, maps, [0, 1], list("abcdefghi")))
    assert len(shown) > 1 and len({row.maximum for row in shown}) == 1 and shown[0].maximum


def test_texels_without_a_material_are_black_in_the_recovered_picture():
    domain = make_domain(6, 8, holes=False)
    domain.stack.values[:, :, :3, :3] = 0
    domain = with_samples(domain, domain.stack.values)
    row = first_row(domain)
    assert not row.recovered[:, :3].any() and row.recovered[:, 3:].any()
    np.testing.assert_array_equal(row.covered, domain.solvable)


def test_a_clipped_pixel_is_white_in_the_photograph_and_no_part_of_the_error():
    domain = make_domain(6, 8, holes=False)
    domain.stack.values[0, 2, 3] = (9, 9, 9, 0)
    row = first_row(domain)
    assert row.covered[2, 3] and (row.reference[2, 3] == 1).all()
    np.testing.assert_array_equal(row.counted, domain.solvable & (domain.stack.values[0, ..., 3] > 0))


def test_texels_unseen_by_the_camera_are_left_out_of_its_photograph():
    domain = make_domain(6, 8, holes=False, card=False)
    domain.stack.values[0, 2, 3] = 0
    assert not first_row(domain).covered[2, 3]
