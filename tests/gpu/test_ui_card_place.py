"""Where a card stands that has no object yet: clear of what is there, and known until somebody moves it."""

import bpy
import numpy as np
import pytest

from irpso_addon.ui import card_place

pytestmark = pytest.mark.bpy_only


@pytest.fixture(autouse=True)
def empty_file():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def test_in_an_empty_scene_a_card_stands_at_the_origin():
    np.testing.assert_array_equal(card_place.free_place(bpy.context, 0.7), np.eye(4))


def test_a_card_stands_beside_what_is_at_the_origin():
    bpy.ops.mesh.primitive_cube_add(size=2)
    bpy.ops.mesh.primitive_cube_add(size=1, location=(3, 0, 0))
    bpy.context.view_layer.update()
    place = card_place.free_place(bpy.context, 1.0)
    assert place[0, 3] - 0.5 > 3.5  # its left edge is clear of the outermost right side
    np.testing.assert_array_equal(place[1:3, 3], 0)


def test_what_stands_elsewhere_is_no_obstacle():
    bpy.ops.mesh.primitive_cube_add(size=2, location=(0, 0, 3))
    bpy.ops.mesh.primitive_cube_add(size=2, location=(4, 0, 0))
    bpy.ops.object.light_add(type="POINT", location=(0, 0, 0))
    bpy.context.view_layer.update()
    np.testing.assert_array_equal(card_place.free_place(bpy.context, 1.0), np.eye(4))


def test_a_card_is_free_until_somebody_moves_it():
    card = bpy.data.objects.new("card", None)
    bpy.context.scene.collection.objects.link(card)
    assert card_place.is_free(card)
    place = np.eye(4)
    place[0, 3] = 1.75
    card_place.put_card(card, place)
    assert card_place.is_free(card) and card.location[0] == 1.75
    card.location[1] = 0.01
    assert not card_place.is_free(card)


def test_what_is_close_to_the_cards_edge_is_in_its_way_too():
    bpy.ops.mesh.primitive_cube_add(size=0.2, location=(0.65, 0, 0))
    bpy.context.view_layer.update()
    assert card_place.free_place(bpy.context, 1.0)[0, 3] > 0.75 + 0.5
