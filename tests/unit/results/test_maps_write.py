"""The files of a result, read back by OpenEXR and by a PNG reader that knows nothing of ours."""

import json
import os
import struct
import zlib
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from irpso_addon.core.errors import InputError
from irpso_addon.core.files import write_json
from irpso_addon.reflectance.model import Parameter, ReflectanceModel
from irpso_addon.results import write
from irpso_addon.results.maps import Maps
from irpso_addon.results.write import check_output_folder, check_replaces_nothing, write_maps

MODEL = ReflectanceModel(
    "mine", "Mine", Path("mine.glsl"),
    (
        Parameter("tint", 3, (0.0, 1.0), (0.5,) * 3, map="tint", color_space="sRGB"),
        Parameter("n", 3, (-1.0, 1.0), (0, 0, 1), map="bumps", is_normal=True),
        Parameter("r1", map="lobes"), Parameter("r2", map="lobes"), Parameter("w", map="lobes"),
        Parameter("strength", range=(0.0, 8.0), map="strength"),
    ),
)  # fmt: skip


@pytest.fixture
def maps():
    rng = np.random.default_rng(3)
    shape = (6, 5)
    normal = rng.normal(size=(*shape, 3)) + (0, 0, 3)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    values = {"tint": rng.random((*shape, 3)), "n": normal, "strength": rng.random((*shape, 1)) * 8}
    values |= {name: rng.random((*shape, 1)) for name in ("r1", "r2", "w")}
    covered = np.ones(shape, bool)
    covered[5, 4] = False
    return Maps(
        MODEL, {k: v.astype(np.float32) for k, v in values.items()}, covered, rng.random(shape).astype(np.float32),
        {"n": rng.random((*shape, 1)).astype(np.float32), "tint": rng.random((*shape, 3)).astype(np.float32)},
    )  # fmt: skip


def read_exr(path):
    """Part name → channel → array, row 0 at the bottom, by OpenEXR itself."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {p.header.get("name", ""): {c: ch.pixels[::-1] for c, ch in p.channels.items()} for p in file.parts}


def read_png_16(path):
    """(H, W, C) uint16, top row first; written from the PNG specification (1996), chapters 3 to 6."""
    data, at, deflated = path.read_bytes(), 8, b""
    while at < len(data):
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        chunk = data[at + 8 : at + 8 + length]
        if kind == b"IHDR":
            width, height, bits, color = struct.unpack(">IIBB", chunk[:10])
        deflated += chunk if kind == b"IDAT" else b""
        at += length + 12
    assert bits == 16
    channels = {0: 1, 2: 3, 6: 4}[color]
    raw = np.frombuffer(zlib.decompress(deflated), np.uint8).reshape(height, -1)
    rows = raw[:, 1:].reshape(height, width, channels * 2)
    assert set(raw[:, 0]) <= {0, 1}
    summed = np.cumsum(rows, axis=1, dtype=np.uint8)
    return (
        np.where(raw[:, :1, None] == 1, summed, rows).reshape(height, -1).view(">u2").reshape(height, width, channels)
    )


def one_part(path):
    return next(iter(read_exr(path).values()))


def test_a_map_of_two_numbers_has_a_black_third_channel(maps, tmp_path):
    model = ReflectanceModel("pair", "Pair", Path("pair.glsl"), (Parameter("x", map="xy"), Parameter("y", map="xy")))
    values = {"x": maps.values["r1"], "y": maps.values["r2"]}
    write_maps(Maps(model, values, maps.solved), tmp_path / "out", {})
    channels = one_part(tmp_path / "out" / "xy.exr")
    assert set(channels) == {"R", "G", "B"}
    np.testing.assert_array_equal(channels["B"], 0)
    np.testing.assert_array_equal(channels["G"][maps.solved], values["y"][maps.solved][:, 0])


def test_every_map_is_written_as_png_and_exr_with_the_users_own_names(maps, tmp_path):
    written = write_maps(maps, tmp_path / "deep" / "out", {"seed": 1}, {"preview": np.zeros((3, 3, 3))})
    names = {f"{stem}.{kind}" for stem in ("tint", "bumps", "lobes", "strength") for kind in ("png", "exr")}
    names |= {"residual.exr", "confidence.exr", "maps.exr", "preview.png", "report.json"}
    assert {path.name for path in written} == names == set(os.listdir(tmp_path / "deep" / "out"))


def test_exr_files_hold_the_numbers_themselves_and_the_normal_is_the_unit_vector(maps, tmp_path):
    write_maps(maps, tmp_path, {})
    covered = maps.solved
    for stem, names, channels in (
        ("tint", ["tint"], "RGB"),
        ("bumps", ["n"], "RGB"),
        ("lobes", ["r1", "r2", "w"], "RGB"),
    ):
        expected = np.concatenate([maps.values[name] for name in names], axis=-1)
        stored = one_part(tmp_path / f"{stem}.exr")
        assert sorted(stored) == sorted(channels)
        for i, channel in enumerate(channels):
            assert stored[channel].dtype == np.float32
            np.testing.assert_array_equal(stored[channel][covered], expected[covered, i])
    np.testing.assert_array_equal(
        one_part(tmp_path / "strength.exr")["Y"][covered], maps.values["strength"][covered, 0]
    )


def test_png_files_hold_the_encoded_numbers_in_16_bits_top_row_first(maps, tmp_path):
    write_maps(maps, tmp_path, {})
    half_step = 0.51 / 65535
    tint = maps.values["tint"].astype(np.float64)
    srgb = np.where(tint <= 0.0031308, tint * 12.92, 1.055 * tint ** (1 / 2.4) - 0.055)
    expected = {"tint": srgb, "bumps": maps.values["n"] * 0.5 + 0.5, "strength": maps.values["strength"] / 8}
    expected["lobes"] = np.concatenate([maps.values[n] for n in ("r1", "r2", "w")], axis=-1)
    for stem, values in expected.items():
        png = read_png_16(tmp_path / f"{stem}.png")[::-1] / 65535
        np.testing.assert_allclose(png[maps.solved], values[maps.solved], atol=half_step + 1e-7)


def test_the_fourth_channel_of_an_srgb_png_is_linear(maps, tmp_path):
    """PNG specification, chapter 12 (alpha samples): the transfer curve applies to colour, never to alpha."""
    tint, gloss = (Parameter(n, count, map="skin", color_space="sRGB") for n, count in (("tint", 3), ("gloss", 1)))
    values = {"tint": maps.values["tint"], "gloss": maps.values["w"]}
    model = ReflectanceModel("skin", "Skin", Path("skin.glsl"), (tint, gloss))
    write_maps(Maps(model, values, maps.solved), tmp_path, {})
    png = read_png_16(tmp_path / "skin.png")[::-1] / 65535
    color = values["tint"].astype(np.float64)
    srgb = np.where(color <= 0.0031308, color * 12.92, 1.055 * color ** (1 / 2.4) - 0.055)
    expected = np.concatenate([srgb, values["gloss"]], axis=-1)
    np.testing.assert_allclose(png[maps.solved], expected[maps.solved], atol=0.51 / 65535 + 1e-7)
    described = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))["maps"]["skin"]
    assert described["png"] == "sRGB, the fourth channel linear"


def test_maps_exr_holds_every_part_and_its_coverage(maps, tmp_path):
    write_maps(maps, tmp_path, {})
    parts = read_exr(tmp_path / "maps.exr")
    assert set(parts) == {
        "tint", "bumps", "lobes", "strength", "residual", "coverage", "confidence_n", "confidence_tint",
    }  # fmt: skip
    np.testing.assert_array_equal(parts["coverage"]["Y"], maps.solved)
    np.testing.assert_array_equal(parts["residual"]["Y"], np.where(maps.solved, maps.residual, 0))
    np.testing.assert_array_equal(parts["confidence_tint"]["B"][maps.solved], maps.confidence["tint"][maps.solved, 2])


def test_the_report_says_what_each_channel_is(maps, tmp_path):
    write_maps(maps, tmp_path, {"seed": 5, "odd": float("inf")})
    report = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert report["seed"] == 5
    assert report["odd"] is None
    assert report["maps"]["lobes"]["channels"] == ["r1", "r2", "w"]
    assert report["maps"]["strength"]["png"] == "fraction of the range (strength 0 to 8)"
    assert sorted(report["files"]) == sorted(os.listdir(tmp_path))


def test_a_report_holds_names_that_are_no_utf_8(maps, tmp_path):
    name = b"caf\xe9".decode("utf-8", "surrogateescape")  # a Latin-1 folder on Linux, as Python decodes it (PEP 383)
    write_maps(maps, tmp_path, {"capture": name, "subject": "Gefäß"})
    text = (tmp_path / "report.json").read_text(encoding="utf-8")
    assert json.loads(text)["capture"] == name and "Gefäß" in text
    write_json(tmp_path / "other.json", {name: name})
    assert json.loads((tmp_path / "other.json").read_text(encoding="utf-8")) == {name: name}


def test_a_second_result_replaces_the_first_and_keeps_other_files(maps, tmp_path):
    (tmp_path / "photo.png").write_bytes(b"mine")
    write_maps(maps, tmp_path, {})
    smaller = ReflectanceModel("other", "Other", Path("o.glsl"), MODEL.parameters[:2])
    write_maps(Maps(smaller, maps.values, maps.solved), tmp_path, {})
    assert set(os.listdir(tmp_path)) == {
        "photo.png", "tint.png", "tint.exr", "bumps.png", "bumps.exr", "maps.exr", "report.json",
    }  # fmt: skip
    assert (tmp_path / "photo.png").read_bytes() == b"mine"


def test_the_material_of_a_former_result_does_not_stand_beside_new_maps(maps, tmp_path):
    (tmp_path / "material.blend").write_bytes(b"the user's")
    write_maps(maps, tmp_path, {})  # no result was here, so the file is not of one
    assert (tmp_path / "material.blend").read_bytes() == b"the user's"
    (tmp_path / "material.blend").write_bytes(b"edited")
    write_maps(maps, tmp_path, {})
    assert not (tmp_path / "material.blend").exists()
    assert (tmp_path / "material.former.blend").read_bytes() == b"edited"
    write_maps(maps, tmp_path, {})
    assert (tmp_path / "material.former.blend").read_bytes() == b"edited"


@pytest.mark.parametrize("name", ["bumps.png", "report.json", "maps.exr"])
def test_a_file_that_no_result_wrote_is_never_replaced(name, maps, tmp_path):
    (tmp_path / name).write_bytes(b"a photograph")
    with pytest.raises(InputError, match=f"{name}: would be replaced"):
        check_replaces_nothing(tmp_path, MODEL)
    with pytest.raises(InputError, match=f"{name} was not written by a recovery"):
        write_maps(maps, tmp_path, {})
    assert os.listdir(tmp_path) == [name] and (tmp_path / name).read_bytes() == b"a photograph"


def test_the_report_of_slots_is_a_former_result(maps, tmp_path):
    (tmp_path / "report.json").write_text('{"texels": 3, "slots": {"Skin": {}}}')
    check_replaces_nothing(tmp_path, MODEL)
    write_maps(maps, tmp_path, {})


def test_a_result_whose_process_was_killed_while_it_moved_files_is_replaced(maps, tmp_path, monkeypatch):
    real, moved = os.replace, []

    def killed(source, place):
        if len(moved) == 3:
            raise KeyboardInterrupt
        moved.append(place)
        real(source, place)

    monkeypatch.setattr(write.tempfile, "TemporaryDirectory", KeptFolder)
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(write.os, "replace", killed)
        write_maps(maps, tmp_path, {})
    assert not (tmp_path / "report.json").exists()
    check_replaces_nothing(tmp_path, MODEL)
    write_maps(maps, tmp_path, {})
    assert (tmp_path / "report.json").exists()


class KeptFolder:
    """A temporary folder that nobody removes, as after signal 9."""

    def __init__(self, prefix, dir):  # noqa: A002
        self.path = Path(dir) / f"{prefix}kept"

    def __enter__(self):
        self.path.mkdir()
        return str(self.path)

    def __exit__(self, *error):
        pass


def test_a_failed_write_keeps_the_old_result(maps, tmp_path, monkeypatch):
    write_maps(maps, tmp_path, {"seed": 1})
    before = {name: (tmp_path / name).read_bytes() for name in os.listdir(tmp_path)}
    real = write.write_exr

    def full_disk(path, parts, half=False):
        if path.name == "maps.exr":
            raise OSError(28, "No space left on device")
        real(path, parts, half)

    monkeypatch.setattr(write, "write_exr", full_disk)
    with pytest.raises(InputError, match="No space left"):
        write_maps(maps, tmp_path, {"seed": 2})
    assert {name: (tmp_path / name).read_bytes() for name in os.listdir(tmp_path)} == before
    with pytest.raises(InputError):
        write_maps(maps, tmp_path / "new" / "folder", {})
    assert not (tmp_path / "new").exists()


def test_an_output_path_that_is_a_file_or_lies_in_one_is_refused(tmp_path):
    file = tmp_path / "file"
    file.write_text("x")
    for path in (file, file / "sub", file / "a" / "b"):
        with pytest.raises(InputError, match="file: is a file"):
            check_output_folder(path)
    assert check_output_folder(tmp_path / "a" / "b") == tmp_path / "a" / "b"
    assert os.listdir(tmp_path) == ["file"]


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="needs Unix permissions")
def test_a_folder_that_cannot_be_written_is_refused():
    # /proc takes no files from anyone, root included; a chmod would not stop root.
    if not Path("/proc/self").is_dir():
        pytest.skip("needs /proc, a place where nobody can make files")
    with pytest.raises(InputError, match="cannot be written"):
        check_output_folder("/proc/irpso/out")


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ((Parameter("n", 3, map="a/b", is_normal=True),), "file name"),
        ((Parameter("n", 3, map="Maps", is_normal=True),), "file name"),
        ((Parameter("a", 1, map="height"),), "file name"),
        ((Parameter("a", 3, map="x"), Parameter("b", 2, map="x")), "5 components"),
        ((Parameter("a", 1, map="x"), Parameter("n", 3, map="x", is_normal=True)), "normal"),
        ((Parameter("a", 1, map="x"), Parameter("b", 1, map="x", color_space="sRGB")), "colour spaces"),
    ],
)
def test_a_table_of_maps_that_cannot_be_written_is_refused_before_anything_is(parameters, message, tmp_path):
    model = ReflectanceModel("mine", "Mine", Path("m.glsl"), parameters)
    with pytest.raises(InputError, match=message):
        write_maps(Maps(model, {}, np.ones((2, 2), bool)), tmp_path / "out", {})
    assert not os.listdir(tmp_path)
