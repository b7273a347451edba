"""Exposures in names and in EXIF, which photographs are brackets, and which are developed."""

import numpy as np
import pytest

from irpso_addon.calibration.photographs import read_photographs
from irpso_addon.calibration.radiometry.brackets import amounts_of, brackets_of, name_amount
from irpso_addon.calibration.radiometry.source import Exposing, read_source
from irpso_addon.capture.formats.diligent import mask_of
from irpso_addon.capture.read import read_spec
from irpso_addon.core.errors import InputError
from irpso_addon.core.files import natural
from tests.builders.captures import LIGHTS, chunk, decode_png, write_diligent, write_png
from tests.builders.exif import exif

EXIF, NAMES = Exposing("exif", True), Exposing("names", True)


def photograph(path, seconds=None, f_number=None, iso=None, value=100, size=(4, 6)):
    block = chunk(b"eXIf", exif(seconds, f_number, iso)) if seconds else b""
    write_png(path, np.full((*size, 3), value), extra=block)
    return path


@pytest.mark.parametrize(
    ("stem", "expected"),
    [
        ("lamp_1-60s", ("lamp", 1 / 60, "seconds")),
        ("lamp 12 0.5s", ("lamp 12", 0.5, "seconds")),
        ("lamp_12_2S", ("lamp_12", 2.0, "seconds")),
        ("lamp-16ms", ("lamp", 0.016, "seconds")),
        ("1-8s", ("", 1 / 8, "seconds")),
        ("lamp_ev-2", ("lamp", 0.25, "stops")),
        ("lamp_EV+1.3", ("lamp", 2**1.3, "stops")),
        ("lamp_ev0", ("lamp", 1.0, "stops")),
        ("lamp_+2EV", ("lamp", 4.0, "stops")),
        ("lamp-1ev", ("lamp", 0.5, "stops")),
        ("lamp_2ev", ("lamp", 4.0, "stops")),
        ("IMG_0012", None),
        ("chess", None),
        ("DSC0012s", None),
        ("lamp_1-0s", None),
        ("lamp_0s", None),
    ],
)
def test_the_end_of_a_name_gives_the_exposure(stem, expected):
    found = name_amount(stem)
    assert found == (None if expected is None else (expected[0], pytest.approx(expected[1]), expected[2]))


def test_names_sort_in_natural_order(tmp_path):
    names = ["a10", "a9", "a1", "B2"]
    assert [p.name for p in sorted((tmp_path / n for n in names), key=natural)] == ["a1", "a9", "a10", "B2"]


def test_a_bracket_ends_where_an_exposure_repeats(tmp_path):
    times = [(1, 60), (1, 15), (1, 240)] * 3
    paths = [photograph(tmp_path / f"IMG_{k + 8}.png", t, (8, 1), 100) for k, t in enumerate(times)]
    brackets, warnings = brackets_of(paths[::-1], "exif")
    assert [b.name for b in brackets] == ["IMG_8", "IMG_11", "IMG_14"] and warnings == []
    assert [p.name for p in brackets[1].paths] == ["IMG_13.png", "IMG_11.png", "IMG_12.png"]
    assert brackets[1].amounts == pytest.approx((1 / 240 / 64, 1 / 60 / 64, 1 / 15 / 64))


def test_a_missing_photograph_of_a_bracket_gives_a_warning(tmp_path):
    times = [(1, 60), (1, 15), (1, 60), (1, 60), (1, 15)]
    paths = [photograph(tmp_path / f"{k}.png", t) for k, t in enumerate(times)]
    brackets, (warning,) = brackets_of(paths, "exif")
    assert [len(b.paths) for b in brackets] == [2, 1, 2] and "2.png" in warning and "missing" in warning


def test_brackets_by_name_share_what_comes_before_the_exposure(tmp_path):
    paths = [tmp_path / f"{lamp}_{e}.png" for lamp in ("a", "b 1") for e in ("ev-2", "ev+0", "ev+2")]
    brackets, _ = brackets_of(paths, "names")
    assert [(b.name, b.amounts) for b in brackets] == [("a", (0.25, 1, 4)), ("b 1", (0.25, 1, 4))]


@pytest.mark.parametrize("first", [0, 1])
def test_numbers_at_the_end_index_the_given_exposures(tmp_path, first):
    paths = [tmp_path / f"007_{k + first}.png" for k in range(3)]
    (bracket,), _ = brackets_of(paths, "names", (0.5, 0.125, 2.0))
    assert [(p.name, a) for p, a in zip(bracket.paths, bracket.amounts, strict=True)] == [
        (f"007_{1 + first}.png", 0.125), (f"007_{first}.png", 0.5), (f"007_{2 + first}.png", 2.0)
    ]  # fmt: skip


def test_unknown_exposures_are_refused(tmp_path):
    plain = [photograph(tmp_path / f"{k}.png") for k in range(3)]
    with pytest.raises(InputError, match=r"0\.png: has no exposure time in its EXIF; .*choose names"):
        brackets_of(plain, "exif")
    with pytest.raises(InputError, match=r"0\.png: its name has no exposure"):
        brackets_of(plain, "names")
    with pytest.raises(InputError, match="some names have seconds and some EV"):
        brackets_of([tmp_path / "a_ev0.png", tmp_path / "a_2s.png"], "names")
    with pytest.raises(InputError, match="--exposures has only 2"):
        brackets_of([tmp_path / f"a_{k}.png" for k in range(3)], "names", (1.0, 2.0))
    with pytest.raises(InputError, match="no two photographs make a bracket"):
        brackets_of([tmp_path / "a_1s.png", tmp_path / "b_1s.png"], "names")
    with pytest.raises(InputError, match="has the exposure of"):
        brackets_of([tmp_path / "a_1s.png", tmp_path / "a_1000ms.png"], "names")


@pytest.mark.parametrize(("tags", "what"), [(((8, 1), None), "ISO"), ((None, 400), "f-number")])
def test_a_file_without_a_tag_that_others_of_its_folder_have_is_refused(tmp_path, tags, what):
    """It would be scaled as ISO 100 or f/1 beside the others."""
    full = [photograph(tmp_path / f"{k}.png", (1, 15 * 2**k), (8, 1), 400) for k in range(2)]
    bare = photograph(tmp_path / "bare.png", (1, 240), *tags)
    for function in (brackets_of, amounts_of):
        with pytest.raises(
            InputError, match=rf"bare\.png: has no {what} in its EXIF, and 1\.png has one; .*choose names"
        ):
            function([*full, bare], "exif")
    (tmp_path / "manual lens").mkdir()
    other = photograph(tmp_path / "manual lens" / "0.png", (1, 240), *tags)
    assert len(amounts_of([*full, other], "exif")) == 3  # of another camera


def test_a_folder_gives_all_photographs_except_left_out_ones(tmp_path):
    for name in ("10.png", "9.png", "mask.png", "dark.png"):
        photograph(tmp_path / name)
    (tmp_path / "notes.txt").write_text("no photograph")
    source = read_source(tmp_path, decode_png, left_out=[tmp_path / "dark.png"])
    assert [(s.name, s.amounts, s.size) for s in source.groups] == [("9", None, (6, 4)), ("10", None, (6, 4))]
    assert source.capture is None


@pytest.mark.parametrize("name", ["mask.png", "Mask.png", "MASK.TIFF", "mask.jpeg", "mask.heic"])
def test_a_mask_of_any_spelling_is_no_photograph(tmp_path, name):
    for other in ("1.png", name):
        photograph(tmp_path / other)
    assert [shot.name for shot in read_source(tmp_path, decode_png).groups] == ["1"]
    spec = read_photographs(tmp_path)
    assert [shot.name for shot in spec.observations] == ["1.png"] and spec.views[0].mask.path == tmp_path / name
    lists(tmp_path, ["1.png"], LIGHTS[:1])
    assert read_spec(tmp_path).views[0].mask.path == tmp_path / name


def test_a_name_that_only_begins_like_a_masks_is_a_photograph(tmp_path):
    photograph(tmp_path / "mask_1.png")
    assert mask_of(tmp_path) is None and [shot.name for shot in read_source(tmp_path, decode_png).groups] == ["mask_1"]


def lists(folder, names, lights):
    (folder / "filenames.txt").write_text("".join(f"{name}\n" for name in names))
    np.savetxt(folder / "light_directions.txt", lights)


def test_a_list_may_name_one_photograph_of_each_bracket(tmp_path):
    for k in range(5):
        for ev in (-2, 0, 2):
            photograph(tmp_path / f"{k}_ev{ev}.png")
    photograph(tmp_path / "card.png")
    lists(tmp_path, [f"{k}_ev0.png" for k in (3, 1, 0, 4)], LIGHTS[[3, 1, 0, 4]])
    source = read_source(tmp_path, decode_png, NAMES)
    assert [[i.path.name for i in s.images] for s in source.groups] == [
        [f"{k}_ev{ev}.png" for ev in (-2, 0, 2)] for k in (3, 1, 0, 4)
    ]
    found = [observation.light.vector for observation in source.capture.observations]
    np.testing.assert_allclose(found, LIGHTS[[3, 1, 0, 4]])
    assert "1 brackets in its folders are not in its list" in source.warnings[0]


def test_brackets_keep_the_order_of_a_list_without_lights(tmp_path):
    for name in "abc":
        photograph(tmp_path / f"{name}_ev0.png"), photograph(tmp_path / f"{name}_ev2.png")
    (tmp_path / "filenames.txt").write_text("c_ev0.png\na_ev2.png\nb_ev0.png\n")
    source = read_source(tmp_path, decode_png, Exposing("names", True))
    assert [group.name for group in source.groups] == ["c", "a", "b"]


def test_a_list_may_name_all_photographs_of_a_bracket_with_one_light(tmp_path):
    names = [photograph(tmp_path / f"{n}.png", t).name for n, t in enumerate([(1, 60), (1, 15)] * 5)]
    lists(tmp_path, names, np.repeat(LIGHTS, 2, axis=0))
    source = read_source(tmp_path, decode_png, EXIF)
    assert [len(s.images) for s in source.groups] == [2] * 5
    np.testing.assert_allclose([o.light.vector for o in source.capture.observations], LIGHTS)
    lists(tmp_path, names, np.repeat(LIGHTS, 2, axis=0)[1:].tolist() + [LIGHTS[0]])
    with pytest.raises(InputError, match="line 2: is in one bracket with .*line 1, but their lights differ"):
        read_source(tmp_path, decode_png, EXIF)


def test_single_frames_are_scaled_by_their_own_exposure(tmp_path):
    names = [photograph(tmp_path / f"{k}.png", (1, 10 * (k + 1))).name for k in range(5)]
    lists(tmp_path, names, LIGHTS)
    source = read_source(tmp_path, decode_png, Exposing("exif", False))
    assert [s.amounts for s in source.groups] == [pytest.approx((0.1 / (k + 1),)) for k in range(5)]


def test_lists_of_light_positions_are_told_as_recover_tells_them(tmp_path):
    for k in range(3):
        photograph(tmp_path / f"{k}.png")
    (tmp_path / "._A.lp").write_bytes(b"\0\5\x16\7")  # of macOS
    assert read_source(tmp_path, decode_png).capture is None
    text = "3\n" + "".join(f"{k}.png 0 {k} 1\n" for k in range(3))
    (tmp_path / "A.LP").write_text(text)
    assert read_source(tmp_path, decode_png).capture is not None
    (tmp_path / "B.lp").write_text(text)
    with pytest.raises(InputError, match="holds 2 .lp files; give the path of the one to read"):
        read_source(tmp_path, decode_png)


def test_parts_of_an_exr_are_no_brackets(tmp_path):
    write_diligent(tmp_path / "a")
    text = '[[camera]]\n[[observation]]\nimage = "000.exr"\npart = 0\nlight_direction = [0, 0, 1]\n'
    (tmp_path / "a" / "capture.toml").write_text(text)
    with pytest.raises(InputError, match="parts of one EXR have no exposures"):
        read_source(tmp_path / "a", None, NAMES)


def test_places_without_photographs_are_refused(tmp_path):
    with pytest.raises(InputError, match="holds no photographs"):
        read_source(tmp_path)
    with pytest.raises(InputError, match="neither a capture nor a folder"):
        read_source(tmp_path / "no")
