"""What is drawn over viewports, as numbers: axes, layouts, curves, rays, domes, frusta, swarms. No window is needed."""

import math
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from mathutils.geometry import intersect_ray_tri

from irpso_addon.capture.camera import Camera
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.views.texel_probe import Particles
from irpso_addon.ui.overlay import flat, legend, surface, swarm
from irpso_addon.ui.overlay.dome import dome_of, frustum, guide_lines, light_colors, over_subject
from irpso_addon.ui.overlay.layout import Rectangle, beside, free_rectangle, stacked, stacked_around
from irpso_addon.ui.overlay.paint import rounded
from irpso_addon.ui.overlay.picking import first_hit, nearest_texel, texel_at, view_ray
from irpso_addon.ui.overlay.place import (
    Placement,
    card_corners,
    card_frame,
    circle,
    pixel_size,
    placement_of,
    to_pixels,
    transformed,
)
from irpso_addon.ui.overlay.plot import curve_plot
from irpso_addon.ui.overlay.swarm import Trail, box_pixels, choose_axes, goal_place, in_box, star, view_of

pytestmark = pytest.mark.bpy_only


def perspective_of(eye, target, lens=50.0, size=(800, 600)):
    """Return a view-projection matrix (4, 4) by Blender's own camera, and the camera's place."""
    camera = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
    bpy.context.scene.collection.objects.link(camera)
    camera.data.lens = lens
    direction = np.subtract(target, eye)
    camera.rotation_euler = __import__("mathutils").Vector(direction).to_track_quat("-Z", "Y").to_euler()
    camera.location = eye
    bpy.context.view_layer.update()
    graph = bpy.context.evaluated_depsgraph_get()
    window = camera.calc_matrix_camera(graph, x=size[0], y=size[1])
    matrix = np.array(window @ camera.matrix_world.inverted())
    bpy.data.objects.remove(camera)
    return matrix


def test_only_overlapping_side_regions_are_kept_free():
    window = Rectangle(100, 50, 800, 600)
    sides = [
        ("LEFT", Rectangle(100, 50, 60, 600)), ("RIGHT", Rectangle(700, 50, 200, 600)),
        ("TOP", Rectangle(100, 620, 800, 30)), ("TOP", Rectangle(100, 650, 800, 26)),
        ("RIGHT", Rectangle(950, 50, 100, 600)), ("FLOAT", Rectangle(120, 60, 200, 90)),
    ]  # fmt: skip
    assert free_rectangle(window, sides) == Rectangle(60, 0, 540, 570)
    assert free_rectangle(window, []) == Rectangle(0, 0, 800, 600)


def test_boxes_are_stacked_upward_then_in_columns_and_left_out_where_there_is_no_room():
    free = Rectangle(10, 20, 500, 400)
    assert stacked(free, [(200, 150), (180, 200)], 10) == [Rectangle(10, 20, 200, 150), Rectangle(10, 180, 180, 200)]
    places = stacked(free, [(200, 150), (180, 300), (400, 100)], 10)
    assert places == [Rectangle(10, 20, 200, 150), Rectangle(220, 20, 180, 300), None]


def test_boxes_lie_left_of_the_legend_or_above_it_if_more_fit():
    legend_box, sizes = Rectangle(410, 20, 100, 210), [(290, 140)]
    wide, high = Rectangle(10, 20, 500, 400), Rectangle(10, 20, 380, 400)
    assert stacked_around(None, wide, sizes, 10) == stacked(wide, sizes, 10)
    assert stacked_around(legend_box, wide, sizes, 10) == [Rectangle(10, 20, 290, 140)]
    (place,) = stacked_around(high.corner(100, 210), high, sizes, 10)  # as in one of a quad view's regions
    assert place == Rectangle(10, 240, 290, 140)


def test_a_name_beside_a_point_covers_no_panel_and_stays_where_there_is_room():
    free, size = Rectangle(0, 0, 400, 300), (80, 20)
    assert beside((100, 100), size, 10, free, []) == Rectangle(110, 90, 80, 20)
    legend_box = Rectangle(110, 0, 100, 200)
    assert beside((100, 100), size, 10, free, [legend_box]) == Rectangle(10, 90, 80, 20)
    assert beside((390, 100), size, 10, free, []) == Rectangle(300, 90, 80, 20)  # not under a sidebar
    assert beside((60, 100), size, 10, free, [legend_box]) == Rectangle(20, 110, 80, 20)
    assert beside((160, 100), size, 10, free, [Rectangle(0, 0, 400, 300)]) is None


def test_the_legend_gets_shorter_in_a_low_region_and_leaves_room_for_the_curves_above_it():
    tall, low = Rectangle(0, 0, 900, 700), Rectangle(0, 0, 380, 380)
    assert legend.legend_size(1.0, tall) == (104.0, 212.0)
    width, height = legend.legend_size(1.0, low)
    assert width == 104.0 and height < 212
    assert None not in stacked_around(low.corner(width, height), low, [(290, 140)], 10)


def test_the_legend_is_as_wide_as_its_longest_text():
    assert legend.legend_size(2.0, Rectangle(0, 0, 900, 700), 300.0)[0] == 300 + 4 * 12


@pytest.mark.parametrize("letter, lines", [(4.5, 1), (8.0, 2)])
def test_the_key_of_the_swarm_stays_in_its_panel(letter, lines):
    area, texts = Rectangle(100, 50, 264, 294), []
    painter = SimpleNamespace(
        scale=1.0, width=lambda text, size: letter * len(text), text=lambda text, x, y, *_: texts.append((text, x, y)),
        dots=lambda *_: None, rings=lambda *_: None, triangles=lambda *_: None,
    )  # fmt: skip
    assert swarm._draw_key(painter, area, True) == lines
    assert [text for text, _, _ in texts] == ["particle", "its best", "best of all", "goal"]
    assert max(x + letter * len(text) for text, x, _ in texts) < area.right
    assert min(y for _, _, y in texts) > area.y and len({y for _, _, y in texts}) == lines
    for (text, x, y), (_, following, below) in zip(texts, texts[1:], strict=False):
        assert following > x + letter * len(text) if below == y else below < y - 10


def seen_with(show_overlays=True, mode="OBJECT", visible=True):
    """Why a viewport draws no maps on a mesh 'Cup', with its overlays, mode and visibility."""
    space = SimpleNamespace(overlay=SimpleNamespace(show_overlays=show_overlays))
    context = SimpleNamespace(space_data=space, view_layer=None, scene=SimpleNamespace(session_uid=1))
    cup = SimpleNamespace(name="Cup", mode=mode, visible_get=lambda view_layer, viewport: visible)
    running = SimpleNamespace(job=SimpleNamespace(name="Cup"), mesh=object())
    return surface.why_unseen(context, running, cup, 1), surface.why_unseen(context, running, None, 1)


def test_a_viewport_that_draws_no_maps_says_why():
    assert seen_with() == ("", "'Cup' has been deleted: undo that")
    assert "overlays are off" in seen_with(show_overlays=False)[0]
    assert "not in Object Mode" in seen_with(mode="EDIT")[0]
    assert "hidden in this viewport" in seen_with(visible=False)[0]


def test_an_image_editor_that_draws_no_map_says_why():
    photograph = bpy.data.images.new("photograph", 2, 2)
    assert flat.why_covered(SimpleNamespace(mode="VIEW", image=None)) == ""
    assert "'photograph'" in flat.why_covered(SimpleNamespace(mode="VIEW", image=photograph))
    assert "choose View" in flat.why_covered(SimpleNamespace(mode="PAINT", image=None))


def test_lights_over_the_subject_are_distinguished_from_those_around_it():
    matrix, size = perspective_of((0, 0, 5), (0, 0, 0)), (800, 600)
    corners = np.array([[x, y, 0] for x in (-0.5, 0.5) for y in (-0.5, 0.5)])
    places = np.array([[0, 0, 1.0], [0.3, -0.2, 0.8], [1.2, 0, 0.5], [0, -0.9, 0.1]])
    assert over_subject(places, corners, matrix, size).tolist() == [True, True, False, False]


def test_observations_are_counted_from_one_in_the_legend():
    shown = surface.Shown("reference", observation=2)
    assert legend.caption(shown, ("a", "b", "c"), (0, 2, 1)) == "Photograph 2: c"


def test_the_legend_of_the_indirect_light_is_in_percent_of_the_light():
    shown, model = surface.Shown("indirect", limit=0.5), load_model("lambert")
    assert legend.scale_of(shown, model) == legend.Scale("Indirect", "% of the light", 50)
    assert legend.caption(shown, ("a",), (0,)) == "Indirect Light"


@pytest.mark.parametrize(
    ("component", "words"),
    [("base_color.g", "Base Color G"), ("normal.x", "Normal X -1 … 1"), ("roughness", "Roughness 0.02 … 1")],
)
def test_swarm_axes_are_named_after_their_parameters(component, words):
    (axis,) = choose_axes([component], [], load_model("principled"))
    assert swarm._axis_text(axis) == words


def test_curves_plot_log_error_over_iteration():
    area = Rectangle(40, 30, 300, 120)
    plot = curve_plot(area, [[(0, 10.0), (50, 1.0), (100, 0.1)], [(0, math.nan), (100, 5.0)], []])
    assert plot.curves[0] == pytest.approx(np.array([(40, 150), (190, 90), (340, 30)]))
    assert plot.curves[1] == pytest.approx(np.array([(340, 30 + 120 * (math.log10(50) / 2))]))
    assert len(plot.curves[2]) == 0
    assert {text: x for x, text in plot.x_ticks}["40"] == pytest.approx(160)
    assert {text: y for y, text in plot.y_ticks} == pytest.approx({"0.1": 30, "1": 90, "10": 150})


def test_a_curve_of_zeros_and_no_curve_at_all_can_be_plotted():
    area = Rectangle(0, 0, 100, 100)
    for curves in ([], [[]], [[(0, 0.0), (5, 0.0)]], [[(3, 0.2)]], [[(i, 1.0) for i in range(10000)]]):
        plot = curve_plot(area, curves)
        assert all(np.isfinite(points).all() for points in plot.curves)
        assert all(len(points) <= 100 for points in plot.curves)
        assert len(plot.y_ticks) >= 2


def test_a_ray_through_a_pixel_meets_the_point_that_is_drawn_there():
    matrix = perspective_of((3, -4, 2), (0.1, 0.2, 0.3))
    size = (800, 600)
    point = np.array([0.4, -0.2, 0.5])
    (pixel,), (before,) = to_pixels(matrix, point[None], size)
    origin, direction = view_ray(matrix, tuple(pixel), size)
    assert before
    assert np.linalg.norm(np.cross(point - origin, direction)) < 1e-4
    assert np.linalg.norm(direction) == pytest.approx(1)
    assert direction @ (point - origin) > 0
    behind = np.array([[6, -8, 4.0]])
    assert not to_pixels(matrix, behind, size)[1][0]


def test_pixel_size_matches_projected_points():
    matrix, size = perspective_of((0, -5, 0), (0, 0, 0)), (800, 600)
    one = pixel_size(matrix, np.zeros(3), size)
    pixels, _ = to_pixels(matrix, np.array([[0, 0, 0], [100 * one, 0, 0]]), size)
    assert pixels[1, 0] - pixels[0, 0] == pytest.approx(100, rel=1e-4)


def test_the_first_triangle_that_a_ray_meets_is_the_one_blender_finds():
    rng = np.random.default_rng(3)
    triangles = rng.uniform(-1, 1, (400, 1, 3)) + rng.uniform(-0.3, 0.3, (400, 3, 3))
    for _ in range(20):
        origin, direction = rng.uniform(-3, 3, 3), rng.normal(size=3)
        direction = -origin / np.linalg.norm(origin) + 0.2 * direction
        found = []
        for i, corners in enumerate(triangles):
            at = intersect_ray_tri(*corners.tolist(), direction.tolist(), origin.tolist(), True)
            if at is not None and (np.array(at) - origin) @ direction > 0:
                found.append((np.linalg.norm(np.array(at) - origin), i, np.array(at)))
        hit = first_hit(origin, direction, triangles)
        if not found:
            assert hit is None
            continue
        _, number, at = min(found, key=lambda item: item[0])
        assert hit[0] == number
        assert hit[1] @ triangles[number] == pytest.approx(at, abs=1e-4)


def test_texels_are_counted_from_the_lower_left_and_the_far_edge_belongs_to_the_last():
    assert texel_at(np.array([0.0, 0.0]), (4, 8)) == (0, 0)
    assert texel_at(np.array([0.9999, 0.26]), (4, 8)) == (1, 7)
    assert texel_at(np.array([1.0, 1.0]), (4, 8)) == (3, 7)
    assert texel_at(np.array([1.001, 0.5]), (4, 8)) is None


def test_the_nearest_texel_that_is_solved_is_taken_within_reach():
    solvable = np.zeros((10, 10), bool)
    solvable[5, 5] = solvable[2, 2] = True
    assert nearest_texel(solvable, 4, 4, 3) == (5, 5)
    assert nearest_texel(solvable, 2, 3, 3) == (2, 2)
    assert nearest_texel(solvable, 9, 9, 3) is None
    assert nearest_texel(solvable, 0, 0, 2) == (2, 2)


@pytest.mark.parametrize("shape", [(30, 40), (1, 5), (6, 1)])
def test_a_card_is_one_wide_around_the_origin_as_its_object_will_be(shape):
    camera = Camera(shape[1], shape[0], (50.0, 50.0), (3.0, 40.0))
    position = camera.points(2.0)
    corners = transformed(card_frame(position), card_corners(position))
    y = 0.5 * shape[0] / shape[1]
    assert corners == pytest.approx(np.array([(-0.5, -y, 0), (0.5, -y, 0), (0.5, y, 0), (-0.5, y, 0)]), abs=1e-9)


def test_distant_lights_lie_on_the_dome_and_near_ones_at_their_position():
    turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = 2 * turn, (5, 6, 7)
    placement = Placement(frame, np.array([1.0, 2.0, 3.0]), 1.5)
    lights = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0.5, 0, 0, 1]])
    dome = dome_of(lights, np.ones((3, 3)), placement, radius=4.0)
    assert dome.places == pytest.approx(np.array([[1, 6, 3], [1, 2, 7], [5, 7, 7]]))
    assert dome.half
    assert dome_of(lights, np.ones((3, 3)), placement).radius == pytest.approx(1.7 * 1.5)
    assert not dome_of(np.array([[1, 0, 0.1, 0], [-1, 0, -0.2, 0], [0, 0, 1, 0.0]]), np.ones((3, 3)), placement).half
    for line in guide_lines(dome):
        assert np.linalg.norm(line - dome.centre, axis=1) == pytest.approx(4.0)
        assert ((line - dome.centre) @ dome.axis >= -1e-6).all()
    assert guide_lines(dome_of(lights[2:], np.ones((1, 3)), placement)) == []


def test_a_lights_colour_shows_its_hue_and_relative_strength():
    colors = light_colors(np.array([[1, 0.5, 0.25], [4, 2, 1], [0, 0, 0]]))
    assert colors[1].max() == pytest.approx(1)
    assert colors[0] / colors[0].max() == pytest.approx(colors[1] / colors[1].max())
    assert 0.35 < colors[0].max() < 1
    assert np.isfinite(colors).all()


@pytest.mark.parametrize("perspective", [True, False])
def test_a_frustum_passes_through_the_corners_of_the_cameras_image(perspective):
    matrix = np.eye(4)
    matrix[:3, 3] = (1, 2, 3)
    camera = Camera(400, 300, (500.0, 510.0), (190.0, 160.0), matrix, perspective)
    lines = frustum(camera, np.eye(4), 0.7)
    rim = lines[:4, 0]
    if perspective:
        pixels, depth = camera.project(rim)
        assert depth == pytest.approx(np.full(4, 0.7))
        assert lines[7:, 0] == pytest.approx(np.tile(matrix[:3, 3], (4, 1)))
    else:
        pixels, _ = camera.project(rim)
    assert pixels == pytest.approx(np.array([[0, 0], [400, 0], [400, 300], [0, 300]]), abs=1e-9)


def test_a_circle_is_flat_and_round():
    normal = np.array([1, 2, 2]) / 3
    points = circle(np.array([1.0, 1, 1]), normal, 0.5) - 1.0
    assert np.linalg.norm(points, axis=1) == pytest.approx(0.5)
    assert points @ normal == pytest.approx(0, abs=1e-12)


def test_the_bounding_sphere_contains_the_placed_corners():
    frame = np.diag([2.0, 3.0, 1.0, 1.0])
    frame[:3, 3] = (1, 1, 1)
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (0, 1) for z in (2, 5)], float)
    placement = placement_of(frame, corners)
    assert placement.centre == pytest.approx([1, 2.5, 4.5])
    assert placement.radius == pytest.approx(np.linalg.norm([2, 1.5, 1.5]))


def test_a_swarm_is_shown_in_a_whole_colour_first_then_in_what_is_searched_first():
    model = load_model("principled")
    names = ("roughness", "base_color.r", "base_color.g", "base_color.b", "normal.x")
    assert [axis.name for axis in choose_axes(names, ("", "", ""), model)] == list(names[1:4])
    axes = choose_axes(names, ("normal.x", "", "gone"), model)
    assert [axis.name for axis in axes] == ["normal.x", "base_color.r", "base_color.g"]
    assert (axes[0].low, axes[0].high, axes[0].index) == (-1, 1, 4)
    assert [axis.name for axis in choose_axes(("roughness",), (), model)] == ["roughness"]
    assert choose_axes((), ("roughness",), model) == []


def test_places_in_the_box_are_fractions_of_each_axis_range():
    axes = choose_axes(("normal.x", "normal.y", "roughness"), (), load_model("principled"))
    low, high = axes[2].low, axes[2].high
    values = np.array([[-1, 0, low], [1, 0.5, high]])
    assert in_box(axes, values) == pytest.approx(np.array([[0, 0.5, 0], [1, 0.75, 1]]))
    assert in_box(axes[:1], values)[:, 1:] == pytest.approx(0)


def test_the_turning_box_stays_inside_its_area_and_keeps_z_upright():
    area = Rectangle(50, 20, 200, 180)
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    extremes = []
    for azimuth in np.linspace(0, 2 * np.pi, 60):
        view = view_of(azimuth, 0.38)
        assert view @ view.T == pytest.approx(np.eye(3), abs=1e-9)
        assert np.linalg.det(view) == pytest.approx(1)
        pixels, _ = box_pixels(corners, view, area)
        assert pixels.min(axis=0)[0] >= 50 - 1e-6 and pixels.max(axis=0)[0] <= 250 + 1e-6
        assert pixels.min(axis=0)[1] >= 20 - 1e-6 and pixels.max(axis=0)[1] <= 200 + 1e-6
        up = pixels[1] - pixels[0]
        assert up[0] == pytest.approx(0, abs=1e-9) and up[1] > 0
        extremes.append(np.ptp(pixels, axis=0))
    reached = np.max(extremes, axis=0)
    assert reached[0] == pytest.approx(200, rel=0.01) or reached[1] == pytest.approx(180, rel=0.01)


def test_box_pixels_orders_points_by_distance_to_the_viewer():
    view = view_of(0.0, 0.3)
    _, depth = box_pixels(np.array([[0.5, 0.0, 0.5], [0.5, 1.0, 0.5]]), view, Rectangle(0, 0, 100, 100))
    assert depth[0] > depth[1]


def swarm_of(positions):
    count, n = positions.shape
    return Particles(("a", "b")[:n], positions, positions, np.zeros(count), positions[0])


def test_a_trail_keeps_the_last_positions_and_begins_anew_with_another_texel():
    trail = Trail()
    for i in range(20):
        trail.update(swarm_of(np.full((4, 2), float(i))), (1, 2))
    assert [positions[0, 0] for positions in trail.positions] == list(range(8, 20))
    trail.update(swarm_of(np.full((4, 2), 19.0)), (1, 2))
    assert len(trail.positions) == 12
    trail.update(swarm_of(np.full((4, 2), 5.0)), (1, 3))
    assert len(trail.positions) == 1
    trail.update(swarm_of(np.full((5, 2), 5.0)), (1, 3))
    assert len(trail.positions) == 1
    trail.update(None, (1, 3))
    assert (len(trail.positions), trail.live) == (1, False)
    trail.update(None, (9, 9))
    assert (len(trail.positions), trail.particles) == (0, None)


def areas(triangles):
    a, b, c = np.reshape(triangles, (-1, 3, 2)).transpose(1, 0, 2)
    return 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


def test_a_panel_covers_its_rectangle_but_for_the_corners():
    got = areas(rounded(Rectangle(5, 6, 100, 40), 8))
    assert (got > 0).all()
    # The corners are quarters of an inscribed polygon of 20 sides.
    rounding = 8 * 8 * (4 - 20 / 2 * math.sin(2 * math.pi / 20))
    assert got.sum() == pytest.approx(100 * 40 - rounding)


def test_a_star_has_five_points():
    points = star(np.zeros(2), 10.0).reshape(-1, 3, 2)[:, 1]
    lengths = np.linalg.norm(points, axis=1)
    assert np.count_nonzero(lengths > 9.9) == 5
    assert points[0] == pytest.approx([0, 10])


def test_the_true_value_is_marked_at_its_particle_position():
    model = load_model("principled")
    names = ("roughness", "base_color.r", "base_color.g", "base_color.b")
    axes = choose_axes(names, (), model)
    truth = np.array([0.2, 0.5, 0.7])
    particle = np.array([0.4, *truth])
    assert goal_place(axes, model.parameter("base_color"), truth) == pytest.approx(in_box(axes, particle))
    assert goal_place(axes, model.parameter("roughness"), np.array([0.4])) is None
