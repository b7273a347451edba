"""Lights in another order than the photographs, on surfaces of the float64 oracles: found, without false alarms."""

import numpy as np
import pytest

from irpso_addon.capture.inspect.light_order import light_order_message
from irpso_addon.capture.inspect.report import inspect_capture
from tests.builders.captures import decode_png
from tests.builders.command_line import dome_lights
from tests.builders.domains import unit
from tests.unit.capture.test_room_light import LIGHTS, SURFACES, photographs, write_photographs

SHUFFLED = np.random.default_rng(3).permutation(24)
# Of a metal most light is in highlights, and nothing is said of it.
MATT = [surface for surface in SURFACES if surface != "metal"]
# Neighbours of a spiral are so close that a list moved by one place does no harm; these are far apart.
SCATTERED = {name: lights[np.random.default_rng(4).permutation(len(lights))] for name, lights in LIGHTS.items()}


def message(surface, order, lights="wide"):
    """Return the message for lights in another order, under room light of 2 %."""
    values = photographs(surface, SCATTERED[lights], 0.02)[0].mean(axis=-1)
    return light_order_message(values, values > 0, SCATTERED[lights][order, None])


@pytest.mark.parametrize("lights", LIGHTS)
@pytest.mark.parametrize("surface", SURFACES)
def test_lights_in_order_are_right(surface, lights):
    assert message(surface, np.arange(len(LIGHTS[lights])), lights) == ""


@pytest.mark.parametrize("surface", MATT)
@pytest.mark.parametrize(("move", "text"), [(-1, "one place further up"), (2, "2 places further down")])
def test_a_moved_list_is_recognised(surface, move, text):
    assert text in message(surface, np.roll(np.arange(24), -move))


@pytest.mark.parametrize("surface", MATT)
def test_a_shuffled_list_is_recognised(surface):
    assert "no better than lights in a random order" in message(surface, SHUFFLED)


@pytest.mark.parametrize("surface", MATT)
@pytest.mark.parametrize("by_number", [False, True])
def test_lights_in_another_order_of_the_names_are_recognised(surface, by_number):
    """``ls`` lists 1.jpg, 10.jpg, 11.jpg … 2.jpg, and the lamps are listed in the order of their numbers; or back."""
    numbers = [f"{n + 1}.jpg" for n in range(24)]
    letters = sorted(numbers)
    names, of_lights = (letters, numbers) if by_number else (numbers, letters)
    order = [of_lights.index(name) for name in names]  # the lamp that lit each photograph
    values = photographs(surface, SCATTERED["wide"][order], 0.02)[0].mean(axis=-1)
    said = light_order_message(values, values > 0, SCATTERED["wide"][:, None], names)
    assert f"names, sorted by the {'numbers' if by_number else 'letters'} in them" in said
    assert "names" not in light_order_message(values, values > 0, SCATTERED["wide"][order][:, None], names)


def test_a_reversed_list_is_recognised():
    assert "the list reversed" in message("clay", np.arange(24)[::-1])


@pytest.mark.parametrize("surface", MATT)
@pytest.mark.parametrize("widest", [20, 30, 40])
def test_a_reversed_list_is_recognised_where_lights_are_close_together(surface, widest):
    lights = dome_lights(14, widest)  # from the middle outward: reversed, every photograph has a light of another tilt
    values = photographs(surface, lights, 0.0)[0].mean(axis=-1)
    assert "the list reversed" in light_order_message(values, values > 0, lights[::-1, None])
    assert light_order_message(values, values > 0, lights[:, None]) == ""


@pytest.mark.parametrize("surface", SURFACES)
def test_unstated_intensities_are_no_wrong_order(surface):
    values = photographs(surface, SCATTERED["wide"], 0)[0].mean(axis=-1)
    values = values * np.exp(np.random.default_rng(1).uniform(-0.7, 0.7, (24, 1)))
    assert light_order_message(values, values > 0, SCATTERED["wide"][:, None]) == ""


@pytest.mark.parametrize("count", [12, 24, 48])
def test_nearly_flat_brushed_metal_raises_no_alarm(count):
    """Its highlights follow no matt shading, in any order."""
    rng = np.random.default_rng(count)
    lights = unit(
        rng.normal(size=(count, 3)) * (1, 1, 0) + (0, 0, 0.6) + np.abs(rng.normal(size=(count, 1))) * (0, 0, 1)
    )
    normals = unit(rng.normal(scale=0.14, size=(400, 3)) * (1, 1, 0) + (0, 0, 1))
    cosine, half = np.maximum(lights @ normals.T, 0), np.maximum(unit(lights + (0, 0, 1)) @ normals.T, 0)
    values = cosine * (0.02 + half**60)
    values = np.maximum(values + rng.normal(scale=0.003 * values.max(), size=values.shape), 0)
    assert light_order_message(values, values > 0, lights[:, None]) == ""


def test_a_ring_is_the_same_from_every_place():
    """A moved ring is a turned one: its errors are those of the right order."""
    angles = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ring = unit(np.stack([np.cos(angles), np.sin(angles), np.full(12, 1.0)], axis=-1))
    values = photographs("clay", ring, 0)[0].mean(axis=-1)
    assert light_order_message(values, values > 0, np.roll(ring, 2, axis=0)[:, None]) == ""


def test_seven_photographs_are_too_few():
    values = photographs("clay", LIGHTS["wide"][:7], 0)[0].mean(axis=-1)
    assert light_order_message(values, values > 0, LIGHTS["wide"][:7][[4, 2, 6, 0, 5, 1, 3], None]) == ""


@pytest.mark.parametrize("shuffled", [False, True])
def test_inspect_names_the_list(shuffled, tmp_path):
    lights = LIGHTS["wide"][SHUFFLED if shuffled else np.arange(24)]
    write_photographs(tmp_path, *photographs("glazed", LIGHTS["wide"], 0), lights)
    found = [finding.message for finding in inspect_capture(tmp_path, decode_png).findings if "order" in finding.code]
    assert len(found) == shuffled
    assert all("compare the list of lights with the photographs" in text and str(tmp_path) in text for text in found)
