"""EXR files: what is written is read, and odd files are understood or refused."""

import struct

import numpy as np
import OpenEXR
import pytest

from irpso_addon.capture import CaptureError, read_exr, write_exr
from irpso_addon.capture.images.image import ImageRef, ImageStore
from irpso_addon.core.errors import InputError

RNG = np.random.default_rng(3)
GREY = RNG.random((5, 7), np.float32)


def samples(path, **where):
    return ImageStore().samples(ImageRef(path, **where))


def corner(x0, y0, x1, y1):
    return np.array([x0, y0], np.int32), np.array([x1, y1], np.int32)


def test_floats_come_back_bit_for_bit_and_row_0_is_the_bottom(tmp_path):
    write_exr(tmp_path / "a.exr", {"": {"R": GREY, "Z": -GREY}})
    found = read_exr(tmp_path / "a.exr")
    assert list(found) == [""] and found[""]["R"].dtype == np.float32
    np.testing.assert_array_equal(found[""]["R"], GREY)
    np.testing.assert_array_equal(found[""]["Z"], -GREY)
    # OpenEXR itself, which counts from the top, is the oracle of the flip.
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        np.testing.assert_array_equal(file.parts[0].channels["R"].pixels[0], GREY[-1])


def test_half_parts_and_layers_come_back_by_name(tmp_path):
    write_exr(tmp_path / "a.exr", {"one": {"diffuse.R": GREY}, "two": {"Y": 2 * GREY}}, half=True)
    found = read_exr(tmp_path / "a.exr")
    assert list(found) == ["one", "two"] and found["two"]["Y"].dtype == np.float16
    np.testing.assert_array_equal(found["one"]["diffuse.R"], GREY.astype(np.float16))


def test_parts_are_found_by_name_and_by_number_whatever_the_order_of_reading(tmp_path):
    write_exr(tmp_path / "a.exr", {str(k): {"Y": GREY + k} for k in range(4)})
    store = ImageStore()
    for part in (2, "0", 3, 2, "1"):
        found = store.samples(ImageRef(tmp_path / "a.exr", part)).rgba
        np.testing.assert_array_equal(found[..., 1], GREY + int(part))
    with pytest.raises(CaptureError, match="no part 'x'.*'0', '1'"):
        store.samples(ImageRef(tmp_path / "a.exr", "x"))
    with pytest.raises(CaptureError, match="no part 4"):
        store.samples(ImageRef(tmp_path / "a.exr", 4))


def test_luminance_alone_serves_all_three_colours(tmp_path):
    write_exr(tmp_path / "a.exr", {"": {"Y": GREY}})
    found = samples(tmp_path / "a.exr").rgba
    for channel in range(3):
        np.testing.assert_array_equal(found[..., channel], GREY)
    assert (found[..., 3] == 1).all()


def test_a_layer_is_taken_by_name_or_because_it_is_the_only_one(tmp_path):
    one = {f"diffuse.{c}": GREY + i for i, c in enumerate("RGB")}
    write_exr(tmp_path / "one.exr", {"": one})
    np.testing.assert_array_equal(samples(tmp_path / "one.exr").rgba[..., 2], GREY + 2)
    write_exr(tmp_path / "two.exr", {"": {**one, **{f"gloss.{c}": 3 * GREY for c in "RGB"}}})
    np.testing.assert_array_equal(samples(tmp_path / "two.exr", layer="gloss").rgba[..., 0], 3 * GREY)
    with pytest.raises(CaptureError, match="several image layers; .*'diffuse', 'gloss'"):
        samples(tmp_path / "two.exr")


def test_chroma_of_lower_resolution_is_refused(tmp_path):
    # OpenEXR's Python writer makes no such file, so the sampling of one channel is set in the header's bytes.
    path = tmp_path / "a.exr"
    write_exr(path, {"": {"RY": GREY, "Y": GREY}})
    full, halved = (b"RY\0" + struct.pack("<iIii", 2, 0, step, step) for step in (1, 2))
    assert path.read_bytes().count(full) == 1
    path.write_bytes(path.read_bytes().replace(full, halved))
    with pytest.raises(CaptureError, match="lower resolution.*save it as RGB"):
        samples(path)


def test_alpha_is_the_weight(tmp_path):
    alpha = np.linspace(0, 1, GREY.size, dtype=np.float32).reshape(GREY.shape)
    write_exr(tmp_path / "a.exr", {"": {"R": GREY, "G": GREY, "B": GREY, "A": alpha}})
    np.testing.assert_array_equal(samples(tmp_path / "a.exr").rgba[..., 3], alpha)


def test_what_is_not_a_number_becomes_0_with_weight_0(tmp_path):
    broken = GREY.copy()
    broken[1, 2], broken[3, 4] = np.nan, np.inf
    write_exr(tmp_path / "a.exr", {"": {"R": broken, "G": GREY, "B": GREY}})
    found = samples(tmp_path / "a.exr")
    assert found.not_finite.sum() == 2 and not found.rgba[1, 2].any() and not found.rgba[3, 4].any()
    assert found.rgba[..., 3].sum() == GREY.size - 2


def test_the_largest_half_and_infinity_carry_no_weight_but_the_same_float_does(tmp_path):
    bright = GREY.copy()
    bright[0, 0], bright[2, 2] = 65504, np.inf
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"Y": bright[::-1].astype(np.float16)}).write(str(tmp_path / "half.exr"))
    found = samples(tmp_path / "half.exr")
    assert found.rgba[..., 3].sum() == GREY.size - 2 and found.clipped.sum() == 2 and not found.not_finite.any()
    largest = float(np.delete(GREY, (0, 2 * 7 + 2)).astype(np.float16).max())
    for place in ((0, 0), (2, 2)):  # both are lower bounds, of all three channels: as bright as any other pixel
        assert found.rgba[place].tolist() == [largest] * 3 + [0] and found.bounds[place].tolist()[3] == -7.5
    write_exr(tmp_path / "float.exr", {"": {"Y": bright}})
    assert samples(tmp_path / "float.exr").rgba[0, 0].tolist() == [65504, 65504, 65504, 1]


def test_values_beyond_half_are_written_as_its_largest(tmp_path):
    bright = GREY.copy()
    bright[1, 1], bright[2, 2], bright[3, 3] = 70000, -1e6, np.nan
    write_exr(tmp_path / "a.exr", {"": {"Y": bright}}, half=True)
    found = read_exr(tmp_path / "a.exr")[""]["Y"]
    assert found[1, 1] == 65504 and found[2, 2] == -65504 and np.isnan(found[3, 3])
    clipped = samples(tmp_path / "a.exr").clipped
    assert clipped[1, 1] and clipped.sum() == 1


def test_an_infinite_half_channel_leaves_the_others_as_they_are(tmp_path):
    red = np.full_like(GREY, np.inf)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    channels = {name: values.astype(np.float16) for name, values in zip("RGB", (red, GREY, GREY), strict=True)}
    OpenEXR.File(header, channels).write(str(tmp_path / "a.exr"))
    found = samples(tmp_path / "a.exr").bounds
    assert (found[..., 0] == GREY.astype(np.float16).max()).all() and (found[..., 3] == -1.5).all()
    np.testing.assert_array_equal(found[..., 1], GREY[::-1].astype(np.float16))


def test_a_half_file_of_infinities_alone_is_as_bright_as_half_allows(tmp_path):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"Y": np.full_like(GREY, np.inf, dtype=np.float16)}).write(str(tmp_path / "a.exr"))
    assert (samples(tmp_path / "a.exr").rgba[..., :3] == 65504).all()


def test_the_data_window_is_placed_in_the_display_window(tmp_path):
    # Five wide and four high from (2, 1) in an 8×6 picture; the last row and column hang over its edge.
    values = RNG.random((6, 7)).astype(np.float32)
    header = {"dataWindow": corner(2, 1, 8, 6), "displayWindow": corner(0, 0, 7, 5), "type": OpenEXR.scanlineimage,
              "compression": OpenEXR.ZIP_COMPRESSION}  # fmt: skip
    OpenEXR.File(header, {"Y": values}).write(str(tmp_path / "a.exr"))
    found = samples(tmp_path / "a.exr").rgba
    expected = np.zeros((6, 8), np.float32)
    expected[1:, 2:] = values[:5, :6]
    np.testing.assert_array_equal(found[..., 0], expected[::-1])
    weight = np.zeros((6, 8))
    weight[1:, 2:] = 1
    np.testing.assert_array_equal(found[..., 3], weight[::-1])


def test_windows_that_do_not_touch_give_a_picture_without_weight(tmp_path):
    header = {"dataWindow": corner(20, 30, 26, 34), "displayWindow": corner(0, 0, 3, 2),
              "type": OpenEXR.scanlineimage, "compression": OpenEXR.NO_COMPRESSION}  # fmt: skip
    OpenEXR.File(header, {"Y": GREY}).write(str(tmp_path / "a.exr"))
    found = samples(tmp_path / "a.exr").rgba
    assert found.shape == (3, 4, 4) and not found.any()


@pytest.mark.parametrize("compression", ["NO", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "DWAA", "DWAB"])
def test_every_compression_is_read_and_a_cut_file_refused_silently(tmp_path, capfd, compression):
    path, values = tmp_path / "a.exr", RNG.random((70, 33)).astype(np.float32)
    OpenEXR.File({"compression": getattr(OpenEXR, f"{compression}_COMPRESSION"), "type": OpenEXR.scanlineimage},
                 {"R": values, "G": values, "B": values}).write(str(path))  # fmt: skip
    np.testing.assert_allclose(samples(path).rgba[..., 0], values[::-1], atol=0.02)
    whole = path.read_bytes()
    for share in (0.3, 0.7, 0.999):
        path.write_bytes(whole[: int(len(whole) * share)])
        with pytest.raises(CaptureError, match="cut short or damaged"):
            samples(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("compression", ["HTJ2K256", "HTJ2K32", "LJ2K", "ZSTD"])
def test_compressions_newer_than_this_reader_are_left_to_openexr(tmp_path, compression):
    kind = getattr(OpenEXR, f"{compression}_COMPRESSION", None)
    if kind is None:
        pytest.skip("not in this version of OpenEXR")
    path, values = tmp_path / "a.exr", RNG.random((70, 33)).astype(np.float16)
    OpenEXR.File({"compression": kind, "type": OpenEXR.scanlineimage},
                 {"R": values, "G": values, "B": values}).write(str(path))  # fmt: skip
    np.testing.assert_allclose(samples(path).rgba[..., 0], values[::-1], atol=0.02)
    whole = path.read_bytes()
    for share in (0.05, 0.3, 0.7, 0.999):
        path.write_bytes(whole[: int(len(whole) * share)])
        with pytest.raises(CaptureError, match=r"a\.exr: .*; (copy or )?export it again"):
            samples(path)


def test_a_compression_that_openexr_does_not_know_is_refused(tmp_path):
    path, values = tmp_path / "a.exr", np.ones((50, 70), np.float32)
    OpenEXR.File({"compression": OpenEXR.PIZ_COMPRESSION, "type": OpenEXR.scanlineimage}, {"Y": values}).write(
        str(path)
    )
    head = b"compression\0compression\0" + struct.pack("<I", 1)
    before, after = path.read_bytes().split(head)
    path.write_bytes(before + head + b"\x63" + after[1:])
    with pytest.raises(CaptureError, match=r"a\.exr: cannot be decoded as OpenEXR \(.*; export it again"):
        samples(path)


def test_a_truncated_multi_part_file_is_refused_at_any_length(tmp_path):
    path = tmp_path / "a.exr"
    write_exr(path, {"a": {"R": GREY}, "b": {"R": GREY}})
    whole = path.read_bytes()
    for length in [*range(0, len(whole), 5), len(whole) - 1]:
        path.write_bytes(whole[:length])
        with pytest.raises(CaptureError):
            read_exr(path)


def test_a_flipped_byte_is_read_or_refused(tmp_path):
    path = tmp_path / "a.exr"
    write_exr(path, {"a": {"R": GREY}, "b": {"R": GREY}})
    whole = path.read_bytes()
    for at in range(8, len(whole), 3):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0x91]) + whole[at + 1 :])
        try:
            read_exr(path)
        except CaptureError as error:
            assert str(path) in str(error)


def test_writing_leaves_nothing_behind_where_it_fails(tmp_path):
    with pytest.raises(ValueError, match="one shape"):
        write_exr(tmp_path / "a.exr", {"a": {"R": GREY}, "b": {"R": GREY[:2]}})
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        write_exr(tmp_path / "file" / "a.exr", {"": {"R": GREY}})
    assert [p.name for p in tmp_path.iterdir()] == ["file"]
