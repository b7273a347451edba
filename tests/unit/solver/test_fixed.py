"""Fixed parameters: what their maps may hold."""

import numpy as np
import pytest

from irpso_addon.core.errors import InputError
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.settings.fixed import full_map

MODEL = load_model("principled")
HOLE = np.array([[True, True], [True, False]])


def test_a_map_of_bytes_is_refused_with_its_range():
    values = np.array([[[128], [200]], [[255], [0]]], np.float32)
    with pytest.raises(
        InputError, match="roughness: its values reach from 128 to 255; scale or clip them to between 0"
    ):
        full_map(MODEL, "roughness", values, HOLE)
    with pytest.raises(InputError, match="fixed base_color: its values reach from -1 to"):
        full_map(MODEL, "base_color", np.array([-1.0, 0.2, 0.3]), HOLE)


def test_values_slightly_outside_are_put_to_the_end_of_the_range_and_others_keep_their_bits():
    low, high = MODEL.parameter("roughness").range
    values = np.array([[[high + 1e-3], [0.3]], [[low], [-7]]], np.float32)
    found = full_map(MODEL, "roughness", values, HOLE)
    np.testing.assert_array_equal(found[HOLE], np.float32([[high], [0.3], [low]]))


def test_single_texels_far_outside_do_not_refuse_a_map():
    low, _ = MODEL.parameter("roughness").range
    values = np.full((10, 10, 1), 0.3, np.float32)
    values[:5, :2] = 0  # a polished part
    found = full_map(MODEL, "roughness", values, np.ones((10, 10), bool))
    np.testing.assert_array_equal(np.unique(found), np.float32([low, 0.3]))


def test_unit_normals_keep_their_bits_and_what_holes_hold_does_not_count():
    normals = np.random.default_rng(1).normal(size=(2, 2, 3))
    normals = (normals / np.linalg.norm(normals, axis=-1, keepdims=True)).astype(np.float32)
    normals[1, 1] = 0
    np.testing.assert_array_equal(full_map(MODEL, "normal", normals, HOLE), normals)
    short = normals * np.float32(0.95)
    once = full_map(MODEL, "normal", short, HOLE)
    np.testing.assert_allclose(once[HOLE], normals[HOLE], atol=1e-6)
    np.testing.assert_array_equal(full_map(MODEL, "normal", once, HOLE), once)
    with pytest.raises(InputError, match="1 texels of the subject hold the vector 0, 0, 0"):
        full_map(MODEL, "normal", normals, np.ones((2, 2), bool))
