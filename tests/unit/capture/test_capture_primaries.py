"""EXR files of other primaries become Rec. 709, against the matrices that the Academy publishes."""

import numpy as np
import OpenEXR
import pytest

from irpso_addon.capture import CaptureError
from irpso_addon.capture.bounds import weight_and_clipped
from irpso_addon.capture.images.image import ImageRef, ImageStore

ACES = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)  # AP0, SMPTE ST 2065-1
ACES_CG = (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767)  # AP1, S-2014-004
REC_709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
# Of the Academy's OpenColorIO configuration (colour-science has the same digits), to linear sRGB.
MATRICES = {
    ACES: [(2.52169, -1.13413, -0.38756), (-0.27648, 1.37272, -0.09624), (-0.01538, -0.15298, 1.16835)],
    ACES_CG: [(1.70505, -0.62179, -0.08326), (-0.13026, 1.14080, -0.01055), (-0.02400, -0.12897, 1.15297)],
}
COLOURS = np.random.default_rng(4).uniform(0.2, 0.9, (4, 6, 3)).astype(np.float32)


def written(path, chromaticities, colours=COLOURS, kind=np.float32, name=None):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    if chromaticities:
        header["chromaticities"] = chromaticities
    if name:
        header["colorInteropID"] = name
    pixels = np.ascontiguousarray(colours[::-1].astype(kind))
    OpenEXR.File(header, {"RGB": pixels}).write(str(path))
    return ImageStore().samples(ImageRef(path))


@pytest.mark.parametrize("chromaticities", list(MATRICES), ids=["ACES2065-1", "ACEScg"])
def test_an_aces_file_becomes_linear_rec_709(tmp_path, chromaticities):
    found = written(tmp_path / "a.exr", chromaticities).rgba
    np.testing.assert_allclose(found[..., :3], COLOURS @ np.array(MATRICES[chromaticities]).T, atol=3e-5)
    assert (found[..., 3] == 1).all()


@pytest.mark.parametrize(("name", "space"), [("lin_ap0_scene", ACES), ("lin_ap1_scene", ACES_CG)])
def test_a_file_that_names_its_space_alone_becomes_linear_rec_709(tmp_path, name, space):
    # As Blender 5 writes renders of a file whose working space is ACEScg.
    found = written(tmp_path / "a.exr", None, name=name).rgba
    np.testing.assert_allclose(found[..., :3], COLOURS @ np.array(MATRICES[space]).T, atol=3e-5)
    for plain in ("lin_rec709_scene", "data"):
        np.testing.assert_array_equal(written(tmp_path / "b.exr", None, name=plain).rgba[..., :3], COLOURS)


def test_a_space_that_is_not_known_is_refused(tmp_path):
    with pytest.raises(CaptureError, match=r"a.exr: is in the colour space 'g24_rec709_display'; export it as linear"):
        written(tmp_path / "a.exr", None, name="g24_rec709_display")


@pytest.mark.parametrize("chromaticities", [None, REC_709, tuple(np.round(REC_709, 3))])
def test_a_file_of_rec_709_stays_bit_for_bit(tmp_path, chromaticities):
    np.testing.assert_array_equal(written(tmp_path / "a.exr", chromaticities).rgba[..., :3], COLOURS)


def test_a_clipped_channel_takes_the_whole_pixel_with_it(tmp_path):
    colours = COLOURS.copy()
    colours[1, 2, 0] = 65504
    found = written(tmp_path / "a.exr", ACES_CG, colours, np.float16)
    assert found.clipped.sum() == 1 and found.rgba[1, 2, 3] == 0
    assert weight_and_clipped(found.bounds[..., 3])[1][
        1, 2
    ].all()  # the matrix mixes the clipped channel into the others


def test_chromaticities_of_no_colour_space_are_refused(tmp_path):
    with pytest.raises(CaptureError, match="a.exr: its chromaticities define no colour space"):
        written(tmp_path / "a.exr", (0.3, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3127, 0.3290))
