"""Where a card stands that has no object yet: clear of what is there, and known until somebody moves it."""

from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from mathutils import Euler, Matrix, Vector

from irpso_addon.capture.camera import Camera
from irpso_addon.ui.operators import scene_setup
from irpso_addon.ui.session import card_place

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


def test_distant_objects_do_not_move_a_card():
    bpy.ops.mesh.primitive_cube_add(size=2, location=(0, 0, 3))
    bpy.ops.mesh.primitive_cube_add(size=2, location=(4, 0, 0))
    bpy.ops.object.light_add(type="POINT", location=(0, 0, 0))
    bpy.context.view_layer.update()
    np.testing.assert_array_equal(card_place.free_place(bpy.context, 1.0), np.eye(4))


def test_a_card_is_free_until_the_user_moves_it():
    card = bpy.data.objects.new("card", None)
    bpy.context.scene.collection.objects.link(card)
    assert card_place.is_automatic(card)
    place = np.eye(4)
    place[0, 3] = 1.75
    card_place.put_card(card, place)
    assert card_place.is_automatic(card) and card.location[0] == 1.75
    card.location[1] = 0.01
    assert not card_place.is_automatic(card)


@pytest.mark.parametrize("width", [2.0, 300.0, 0.1])
def test_a_card_of_the_captures_size_keeps_the_proportions_of_its_relief(width):
    """Its displacement is in its own unit, of which it is one wide."""
    card = bpy.data.objects.new("card", None)
    scene_setup.place_card(card, Camera.orthographic(16, 12, width), 5.0)
    scales = np.linalg.norm(np.array(card.matrix_world)[:3, :3], axis=0)
    np.testing.assert_allclose(scales, width, rtol=1e-6)


def test_an_object_near_the_cards_edge_moves_it():
    bpy.ops.mesh.primitive_cube_add(size=0.2, location=(0.65, 0, 0))
    bpy.context.view_layer.update()
    assert card_place.free_place(bpy.context, 1.0)[0, 3] > 0.75 + 0.5


def shown(card, place, height=0.5, sight=None):
    """The view of a window after ``show_card``. sight: (4, 4) of what it shows, None for something far away."""
    nothing = Matrix.Translation((1000, 0, 0))
    view = SimpleNamespace(perspective_matrix=nothing if sight is None else sight, view_perspective="CAMERA")
    areas = [
        SimpleNamespace(type="VIEW_3D", width=20, height=20, spaces=SimpleNamespace(active=None)),
        SimpleNamespace(
            type="VIEW_3D", width=90, height=40, spaces=SimpleNamespace(active=SimpleNamespace(region_3d=view))
        ),
        SimpleNamespace(type="IMAGE_EDITOR", width=500, height=500),
    ]
    window = SimpleNamespace(screen=SimpleNamespace(areas=areas))
    card_place.show_card(SimpleNamespace(window=window, area=areas[2]), card, place, height)
    return view


def test_the_largest_viewport_turns_to_the_place_of_a_card_from_straight_above():
    place = np.eye(4)
    place[0, 3] = 1.75
    view = shown(None, place)
    assert view.view_location == Vector((1.75, 0, 0)) and view.view_perspective == "PERSP"
    assert view.view_rotation.to_euler() == Euler() and 1.5 < view.view_distance < 3
    assert shown(None, place, height=3.0).view_distance == pytest.approx(3 * view.view_distance)


def test_the_view_turns_to_a_card_out_of_sight_only():
    turn = Euler((0.3, 0.8, 0.1))
    card = SimpleNamespace(matrix_world=Matrix.LocRotScale((3, 4, 5), turn, (2, 2, 2)))
    view = shown(card, np.eye(4))
    assert (view.view_location - Vector((3, 4, 5))).length < 1e-5
    assert (view.view_rotation @ Vector((0, 0, 1)) - turn.to_matrix() @ Vector((0, 0, 1))).length < 1e-5
    assert view.view_distance == pytest.approx(2 * shown(None, np.eye(4)).view_distance)
    before = shown(card, np.eye(4), sight=Matrix.Diagonal((0.1, 0.1, 0.1, 1)))
    assert before.view_perspective == "CAMERA" and not hasattr(before, "view_location")
