"""Damaged images of a capture: refused with the option that leaves them out, and left out of every layout alike."""

import numpy as np
import pytest

from irpso_addon.capture import CaptureError, read_capture, write_exr
from irpso_addon.capture.inspect import damage
from irpso_addon.capture.inspect.report import inspect_capture
from irpso_addon.commands.options.hold_out import held_out_list
from tests.builders.captures import LIGHTS, decode_png, shade, sphere, write_diligent, write_png

NORMALS, MASK = sphere(24)
ALL = np.concatenate([LIGHTS, LIGHTS[1:] * (0.5, 0.5, 1)])  # nine
ALL /= np.linalg.norm(ALL, axis=1, keepdims=True)
FRAMES = shade(NORMALS, ALL).astype(np.float32)


def codes(frame):
    return np.minimum(frame[::-1, :, None] * 200, 255).round().repeat(3, axis=-1)


def diligent(folder):
    write_diligent(folder, FRAMES, ALL, MASK)
    for k, frame in enumerate(FRAMES):  # PNG: what is cut short there, the headers tell
        write_png(folder / f"{k:03d}.png", codes(frame))
    (folder / "filenames.txt").write_text("".join(f"{k:03d}.png\n" for k in range(len(FRAMES))))
    return folder


def lp(folder):
    diligent(folder)
    rows = [f"{k:03d}.png {x} {y} {z}" for k, (x, y, z) in enumerate(ALL)]
    (folder / "dome.lp").write_text("\n".join([str(len(rows)), *rows]))
    return folder / "dome.lp"


def table(folder):
    diligent(folder)
    rows = [f'[[observation]]\nimage = "{k:03d}.png"\nlight_direction = {light.tolist()}\n'
            for k, light in enumerate(ALL)]  # fmt: skip
    (folder / "capture.toml").write_text("[[camera]]\nmask = 'mask.exr'\n" + "".join(rows))
    return folder / "capture.toml"


def gone(path):
    path.unlink()


def cut(path):
    path.write_bytes(path.read_bytes()[:-30])


def junk(path):
    path.write_bytes(b"junk")


def small(path):
    write_png(path, codes(FRAMES[0][:12, :12]))


def rotten(path):
    """A header that is fine, and pixels that are not."""
    data = bytearray(path.read_bytes())
    at = data.index(b"IDAT")
    data[at + 6 : at + 30] = bytes(24)
    path.write_bytes(data)


def decode(path):
    try:
        return decode_png(path)
    except Exception as error:
        raise CaptureError(f"{path}: cannot be decoded; copy it again", "image_truncated") from error


@pytest.mark.parametrize("layout", [diligent, lp, table])
@pytest.mark.parametrize("harm", [gone, cut, junk, small, rotten])
def test_a_damaged_image_is_left_out_with_its_light_whatever_is_wrong_with_it(tmp_path, layout, harm):
    path = layout(tmp_path)
    harm(tmp_path / "003.png")
    capture = read_capture(path, decode, skip_damaged=True)
    assert [one.index for one in capture.left_out] == [3] and "003.png" in capture.left_out[0].why
    assert capture.left_out[0].image == str(tmp_path / "003.png")
    expected = np.delete(ALL, 3, axis=0)
    np.testing.assert_allclose([o.light.vector for o in capture.observations], expected, atol=1e-6)
    whole = np.delete(FRAMES, 3, axis=0)
    for observation, frame in zip(capture.observations, whole, strict=True):
        colour = observation.read()[..., 0]
        assert np.corrcoef(colour[MASK], frame[MASK])[0, 1] > 0.9
    if layout is table:
        np.testing.assert_array_equal(capture.masks[0], MASK)


@pytest.mark.parametrize("harm", [gone, cut, junk, small, rotten])
def test_a_damaged_image_is_refused_with_the_option_that_leaves_it_out(tmp_path, harm):
    path = diligent(tmp_path)
    harm(tmp_path / "003.png")
    message = r"003\.png.*; or leave it out with --skip-damaged$"
    with pytest.raises(CaptureError, match=message) as caught, damage.with_skip_remedy(skipping=False):
        for observation in read_capture(path, decode).observations:
            observation.read()
    assert "\n" not in str(caught.value)
    with pytest.raises(CaptureError) as caught, damage.with_skip_remedy(skipping=True):
        for observation in read_capture(path, decode).observations:
            observation.read()
    assert "--skip-damaged" not in str(caught.value)


def test_a_frame_without_a_number_is_damaged(tmp_path):
    frames = FRAMES.copy()
    frames[2] = np.nan
    write_diligent(tmp_path, frames, ALL, MASK)
    capture = read_capture(tmp_path, skip_damaged=True)
    assert [one.why for one in capture.left_out] == [
        f"{tmp_path / '002.exr'}: none of its pixels is a number; render or export it again"
    ]
    frames[2, 5, 5] = 1.0  # a single one is enough
    write_exr(tmp_path / "002.exr", {"": dict.fromkeys("RGB", frames[2])})
    assert read_capture(tmp_path, skip_damaged=True).left_out == ()


def test_faults_of_the_list_or_the_mask_are_never_skipped(tmp_path):
    path = table(tmp_path)
    (tmp_path / "003.png").unlink()
    path.write_text(path.read_text().replace('image = "005.png"', 'image = "005.exr"\npart = "gone"'))
    with pytest.raises(CaptureError, match=r"005\.exr: has no part 'gone'"):
        read_capture(path, decode, skip_damaged=True)
    diligent(tmp_path / "b")
    (tmp_path / "b" / "mask.exr").write_bytes(b"junk")
    with pytest.raises(CaptureError, match=r"mask\.exr") as caught, damage.with_skip_remedy(skipping=False):
        read_capture(tmp_path / "b", decode)
    assert "--skip-damaged" not in str(caught.value)


def test_a_camera_with_only_damaged_images_is_removed(tmp_path):
    diligent(tmp_path)
    cameras = "".join(f'[[camera]]\nname = "{name}"\nfov_degrees = {fov}\n' for name, fov in (("a", 20), ("b", 40)))
    rows = "".join(
        f'[[observation]]\nimage = "{k:03d}.png"\nlight_direction = {light.tolist()}\ncamera = "{"ab"[k >= 2]}"\n'
        for k, light in enumerate(ALL)
    )
    (tmp_path / "capture.toml").write_text(cameras + rows)
    for k in (0, 1):
        (tmp_path / f"{k:03d}.png").unlink()
    capture = read_capture(tmp_path, decode, skip_damaged=True)
    assert len(capture.cameras) == len(capture.masks) == 1 and {o.camera for o in capture.observations} == {0}
    assert capture.cameras[0].scale[0] == pytest.approx(12 / np.tan(np.radians(20)))


def test_a_capture_without_an_intact_image_is_refused(tmp_path):
    diligent(tmp_path)
    for k in range(len(ALL)):
        (tmp_path / f"{k:03d}.png").unlink()
    with pytest.raises(CaptureError, match=r"000\.png: this image is not there.*all other images"):
        read_capture(tmp_path, decode, skip_damaged=True)


def test_indices_follow_the_list_despite_left_out_images(tmp_path):
    diligent(tmp_path)
    for k in (2, 5):
        (tmp_path / f"{k:03d}.png").unlink()
    capture = read_capture(tmp_path, decode, skip_damaged=True)
    assert capture.listed == 9 and capture.numbers([0, 2, 3, 5, 8]) == [0, 2, 6]
    assert capture.observations[capture.numbers([8])[0]].name == "008.png"


def test_a_left_out_image_has_its_name_in_the_table(tmp_path):
    path = table(tmp_path)
    text = path.read_text()
    for k in (2, 5):
        text = text.replace(f'image = "{k:03d}.png"', f'name = "lamp {k}"\nimage = "{k:03d}.png"')
    path.write_text(text)
    (tmp_path / "002.png").unlink()
    names = read_capture(path, decode, skip_damaged=True).listed_names
    assert names[2] == "lamp 2" and names[5] == "lamp 5"
    assert held_out_list("lamp 2,lamp 5", names) == [2, 5]


def test_an_image_that_changes_is_decoded_again(tmp_path, monkeypatch):
    diligent(tmp_path)
    decoded = []
    monkeypatch.setattr(damage, "_sizes", {})

    def counting(path):
        decoded.append(path.name)
        return decode(path)

    read_capture(tmp_path, counting, skip_damaged=True)
    assert len(decoded) == 9
    read_capture(tmp_path, counting, skip_damaged=True)
    assert len(decoded) == 9
    rotten(tmp_path / "004.png")
    assert [one.index for one in read_capture(tmp_path, counting, skip_damaged=True).left_out] == [4]
    assert decoded[9:] == ["004.png"]


def test_inspect_names_left_out_images_and_checks_the_rest(tmp_path):
    diligent(tmp_path)
    rotten(tmp_path / "003.png")
    (tmp_path / "007.png").unlink()
    assert not inspect_capture(tmp_path, decode).usable
    found = inspect_capture(tmp_path, decode, skip_damaged=True)
    assert found.usable and dict(found.facts)["images"] == "7, 2 more left out"
    assert [f.message.split(": ")[1].rpartition("/")[2] for f in found.findings if f.code == "left_out"] == [
        "003.png", "007.png"
    ]  # fmt: skip
    for k in (0, 1, 2, 4, 5):
        (tmp_path / f"{k:03d}.png").unlink()
    found = inspect_capture(tmp_path, decode, skip_damaged=True)
    assert not found.usable and any("has 2 lights; a normal needs at least three" in f.message for f in found.findings)
