"""Pictures: where things are drawn, and what colours errors have."""

import itertools
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from irpso_addon.core.canvas import Canvas
from irpso_addon.reflectance.model import Parameter
from irpso_addon.results.false_color import COLORS, UNCOVERED, false_color
from irpso_addon.results.preview import (
    MARK_COLORS,
    Curves,
    PreviewRow,
    convergence,
    display_image,
    gallery,
    on_one_scale,
    preview,
    strip,
)

CODE = 0.6 / 255  # a picture has 8 bits


def oklab_lightness(rgb):
    """Ottosson 2020, from sRGB."""
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    to_lms = np.array([[0.41222, 0.53633, 0.05145], [0.21190, 0.68070, 0.10740], [0.08830, 0.28172, 0.62998]])
    return np.cbrt(linear @ to_lms.T) @ (0.21045, 0.79362, -0.00407)


def test_low_errors_are_blue_high_ones_red_and_uncovered_texels_grey():
    error = np.array([[0.0, 1.0, 7.0, np.nan, 0.5]])
    colors = false_color(error, 1.0, np.array([[1, 1, 1, 1, 0]], bool))[0]
    assert colors[0].argmax() == 2
    assert colors[1].argmax() == 0
    np.testing.assert_array_equal(colors[1], colors[2])
    np.testing.assert_allclose(colors[3:], [UNCOVERED] * 2)


def test_the_colour_scale_gets_lighter_up_to_two_thirds_and_has_no_flat_part():
    ramp = false_color(np.linspace(0, 1, 256)[None], 1.0)[0].astype(np.float64)
    lightness = oklab_lightness(ramp)
    assert (np.diff(lightness[:165]) > 0).all()
    steps = np.linalg.norm(np.diff(ramp, axis=0), axis=1)
    assert steps.min() > 0.15 * steps.mean()


def test_a_straight_line_covers_its_own_area_only():
    canvas = Canvas(40, 30, (0, 0, 0))
    canvas.lines([[(10, 15), (30, 15)]], 3.0, (1, 1, 1))
    ink = canvas.result()[..., 0]
    assert ink.sum() == pytest.approx(20 * 3, rel=0.03)
    assert ink[15, 20] == 1
    assert not ink[:12].any()


def test_signs_that_the_font_lacks_are_spelled_in_letters():
    sheets = [Canvas(160, 40), Canvas(160, 40)]
    for canvas, text in zip(sheets, ("4 × 4 – 3σ", "4 x 4 - 3sigma"), strict=True):
        canvas.text(4, 20, text, 9)
        canvas.text_upward(150, 20, text[-2:] if text[-1] == "σ" else text[-6:], 9)
    np.testing.assert_array_equal(*(canvas.result() for canvas in sheets))


def inked(text):
    canvas = Canvas(200, 40)
    canvas.text(4, 20, text, 9)
    canvas.text_upward(190, 20, text, 9)
    return canvas.result()


@pytest.mark.parametrize(("one", "other"), [("ünï", "ânô"), ("фото", "лето"), ("写真", "風景"), ("भवन", "फोटो")])
def test_names_outside_ascii_can_be_told_apart(one, other):
    boxes = inked("\uffff" * len(one))
    assert not any(np.array_equal(*pair) for pair in itertools.combinations((inked(one), inked(other), boxes), 2))


def test_letters_that_no_font_has_are_written_as_their_codes(monkeypatch):
    monkeypatch.setitem(sys.modules, "bpy", None)
    np.testing.assert_array_equal(inked("真 ± ×.jpg"), inked("\\u771f ± x.jpg"))


def test_a_font_that_cannot_be_opened_costs_letters_and_no_picture(monkeypatch, tmp_path):
    """Pillow's own libraries may lack WOFF2, and pictures are drawn before the maps of a recovery are written."""
    from PIL import ImageFont

    real = ImageFont.truetype

    def fails(font, *arguments, **options):
        if isinstance(font, Path):  # Pillow opens its own from memory
            raise OSError("unknown file format")
        return real(font, *arguments, **options)

    (tmp_path / "Inter.woff2").touch()
    bpy = SimpleNamespace(utils=SimpleNamespace(system_resource=lambda *_, **__: str(tmp_path)))
    monkeypatch.setitem(sys.modules, "bpy", bpy)
    monkeypatch.setattr(ImageFont, "truetype", fails)
    np.testing.assert_array_equal(inked("真.jpg"), inked("\\u771f.jpg"))


def test_a_display_image_encodes_each_kind_of_map():
    half = np.full((2, 2, 1), 0.5, np.float32)
    grey = display_image([Parameter("a", 1, (0.0, 2.0), map="a")], [half])
    np.testing.assert_allclose(grey, 0.25)
    shared = display_image([Parameter("a", map="x"), Parameter("b", map="x")], [half, half * 2])
    np.testing.assert_allclose(shared[0, 0], (0.5, 1.0, 0.0))
    color = display_image([Parameter("c", 3, map="c", color_space="sRGB")], [half.repeat(3, -1)])
    np.testing.assert_allclose(color[0, 0], 0.735357, atol=1e-5)
    normal = display_image([Parameter("n", 3, map="n", is_normal=True)], [np.broadcast_to([0, 0.6, 0.8], (2, 2, 3))])
    np.testing.assert_allclose(normal[0, 0], (0.5, 0.8, 0.9), atol=1e-6)


def test_a_preview_shows_uncounted_texels_without_their_error():
    image, error = np.full((30, 20, 3), 0.5, np.float32), np.zeros((30, 20))
    error[10:, :] = 50.0
    counted = np.zeros((30, 20), bool)
    counted[:10] = True
    picture = preview([PreviewRow("Row", image, image, error, "%", np.ones((30, 20), bool), counted)])
    grey = (np.abs(picture - 0.5).max(axis=-1) < CODE).sum()
    assert grey >= 2 * 30 * 20 * 12**2  # both pictures whole, 12 pixels a texel
    blue = (np.abs(picture - COLORS[0]).max(axis=-1) < CODE).sum()
    assert 10 * 20 * 12**2 <= blue < 15 * 20 * 12**2


def test_a_preview_enlarges_tiny_maps_texel_by_texel_and_shows_reference_and_result_upright():
    reference = np.zeros((30, 20, 3), np.float32)
    reference[:15] = (1.0, 0, 1.0)  # the lower half
    recovered = np.zeros((30, 20, 3), np.float32)
    recovered[:, :10] = (0, 1.0, 1.0)
    picture = preview([PreviewRow("Row", reference, recovered, np.ones((30, 20)), "°")])
    magenta = np.argwhere((picture == (1, 0, 1)).all(-1))
    cyan = np.argwhere((picture == (0, 1, 1)).all(-1))
    assert len(magenta) == 15 * 20 * 12**2
    assert len(cyan) == 30 * 10 * 12**2
    assert magenta[:, 0].min() == cyan[:, 0].min()
    assert magenta[:, 0].max() < cyan[:, 0].max()
    assert magenta[:, 1].max() < cyan[:, 1].min()


def test_rows_on_one_scale_have_the_red_of_the_largest_error_that_counts():
    image, counted = np.zeros((4, 5, 3), np.float32), np.ones((4, 5), bool)
    counted[0, 0] = False
    large = np.full((4, 5), 8.5)
    large[0, 0] = 90.0
    rows = [PreviewRow("a", image, image, np.full((4, 5), 3.0), "%"),
            PreviewRow("b", image, image, large, "%", counted=counted)]  # fmt: skip
    assert [row.maximum for row in on_one_scale(rows)] == [10.0, 10.0] and on_one_scale([]) == []


def test_large_maps_are_reduced_by_averaging():
    image = np.zeros((1200, 700, 3), np.float32)
    image[::3] = 1
    picture = preview([PreviewRow("Row", image, image, np.zeros((1200, 700)))])
    assert picture.shape[0] < 800
    assert (np.abs(picture - 1 / 3).max(-1) < 1e-3).sum() > 100_000


def test_a_gallery_shows_maps_upright_with_uncovered_texels_apart():
    red, ramp = np.zeros((30, 40, 3), np.float32), np.zeros((30, 40, 3), np.float32)
    red[..., 0] = 1
    ramp[-5:] = 1  # the upper edge: row 0 is at the bottom
    covered = np.ones((30, 40), bool)
    covered[:, :10] = False
    picture = gallery("50 %", [red, ramp], ["Base color", "Normal"], covered)
    reds = (picture == (1, 0, 0)).all(axis=-1)
    scale = round((reds.sum() / covered.sum()) ** 0.5)
    assert scale > 1 and reds.sum() == covered.sum() * scale**2
    rows, columns = np.nonzero((picture == 1).all(axis=-1))
    low, high = np.nonzero(reds.any(axis=1))[0][[0, -1]]
    assert rows.min() >= high + 1 - 5 * scale and rows.max() == high and low < rows.min()
    assert columns.min() > np.nonzero(reds.any(axis=0))[0].max()


def test_convergence_marks_texels_counted_from_the_lower_left_and_draws_a_curve_for_each():
    image = np.full((36, 24, 3), 0.5, np.float32)
    iterations = np.arange(0, 101, 10)
    errors = np.stack([np.full(11, 10.0 * (k + 1)) for k in range(4)], axis=1)
    picture = convergence(image, [(2, 3), (21, 3), (2, 32), (21, 32)], [Curves("Normal", iterations, errors, "°")])
    inside = np.zeros(picture.shape[:2], bool)
    inside[:, : 28 + 24 * 10] = True
    centres, heights = [], []
    for color in MARK_COLORS:
        close = np.abs(picture - np.asarray(color, np.float32)).max(-1) < 0.02
        centres.append(np.argwhere(close & inside).mean(axis=0))
        heights.append(np.argwhere(close & ~inside)[:, 0].mean())
    low, left = 52, 28
    for (row, column), (x, y) in zip(centres, [(2, 3), (21, 3), (2, 32), (21, 32)], strict=True):
        assert (column, row) == pytest.approx((left + (x + 0.5) * 10, low + (y + 0.5) * 10), abs=1.5)
    assert heights == sorted(heights)
    assert np.diff(heights) == pytest.approx(np.diff(heights).mean(), abs=1.0)


def test_a_logarithmic_axis_spaces_decades_evenly():
    image = np.full((36, 24, 3), 0.5, np.float32)
    errors = np.stack([np.full(3, v) for v in (50.0, 5.0, 0.5, 0.05)], axis=1)
    picture = convergence(image, [(0, 0)] * 4, [Curves("N", np.array([0, 5, 10]), errors, log=True)])
    heights = []
    for color in MARK_COLORS[:3]:
        close = np.abs(picture - np.asarray(color, np.float32)).max(-1) < 0.02
        close[:, : 28 + 240] = False
        heights.append(np.argwhere(close)[:, 0].mean())
    assert heights[0] - heights[1] == pytest.approx(heights[1] - heights[2], abs=1.5)


def test_a_curve_leaves_out_what_is_not_a_number():
    image = np.full((36, 24, 3), 0.5, np.float32)
    whole = np.stack([np.full(5, v) for v in (4.0, 3.0, 2.0, 1.0)], axis=1)
    broken = whole.copy()
    broken[2] = np.nan
    iterations = np.array([0, 2, 5, 8, 10])
    pictures = [convergence(image, [], [Curves("N", iterations, errors)]) for errors in (whole, broken)]
    # The neighbours' straight connection is the same line.
    np.testing.assert_allclose(pictures[0], pictures[1], atol=1e-3)


def test_a_strip_shares_one_scale_over_all_columns():
    images = [np.full((30, 20, 3), v, np.float32) for v in (0.3, 0.6, 0.9)]
    errors = [np.full((30, 20), v) for v in (8.0, 4.0, 1.0)]
    picture = strip(images, errors, ["iteration 0", "iteration 100", "iteration 300"], maximum=4.0)
    red, low = false_color(np.array([[4.0, 1.0]]), 4.0)[0]
    assert (np.abs(picture - red).max(-1) < CODE).sum() >= 2 * 30 * 20 * 12**2
    assert (np.abs(picture - low).max(-1) < CODE).sum() >= 30 * 20 * 12**2
