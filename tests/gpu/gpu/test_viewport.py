"""What is drawn in windows, drawn into a frame buffer and compared with pixels that numpy fills."""

import numpy as np
import pytest

from irpso_addon.gpu import context, textures
from irpso_addon.gpu.viewport import Drawing, Surface, toward_viewer, viewport_size
from tests.builders.domains import makers

SIZE = 48, 36
UNIT_SQUARE = [[0, 0], [1, 0], [1, 1], [0, 0], [1, 1], [0, 1]]  # of two triangles
QUAD = np.array([[0, 0], [1, 0], [1, 1], [0, 0], [1, 1], [0, 1]], float).reshape(2, 3, 2)
PICTURE = np.array([[[0.5, 0.5, 0.5, 1], [1, 0, 0, 1]], [[0.2, 0.4, 0.8, 1], [0, 1, 0, 0]]], np.float32)
NEAR, FAR = 0.1, 100.0
# A perspective camera at (0, 0, 5) that looks down −z, and an orthographic one over [−3, 3]².
EYE = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -5], [0, 0, 0, 1]], float)
LENS = np.array(
    [[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, (FAR + NEAR) / (NEAR - FAR), 2 * FAR * NEAR / (NEAR - FAR)], [0, 0, -1, 0]]
)
PERSPECTIVE = LENS @ EYE
ORTHOGRAPHIC = np.diag([1 / 3, 1 / 3, -2 / FAR, 1]) @ EYE


class Window:
    """A frame buffer with depth, cleared to transparent black and to a depth in −1…1."""

    def __init__(self, depth=1.0):
        import gpu

        context.ensure()
        self.color = gpu.types.GPUTexture(SIZE, format="RGBA32F")
        self._depth = gpu.types.GPUTexture(SIZE, format="DEPTH_COMPONENT32F")
        self._framebuffer = gpu.types.GPUFrameBuffer(depth_slot=self._depth, color_slots=[self.color])
        with self:
            self._framebuffer.clear(color=(0.0, 0.0, 0.0, 0.0), depth=0.5 * depth + 0.5)

    def __enter__(self):
        import gpu

        self._bound = self._framebuffer.bind()
        self._bound.__enter__()
        gpu.state.viewport_set(0, 0, *SIZE)
        return self

    def __exit__(self, *error):
        self._bound.__exit__(*error)

    def pixels(self):
        """(H, W, 4), row 0 at the bottom."""
        return textures.download(self.color)


@pytest.fixture
def drawing():
    made = Drawing()
    yield made
    made.close()


@pytest.fixture
def surface():
    """A maker of surfaces, which are closed at the end."""
    yield from makers(lambda positions, uvs=QUAD: Surface(positions, uvs))


def square(z=0.0, side=2.0):
    """(2, 3, 3) triangles of a square around the z axis."""
    return np.concatenate([(QUAD - 0.5) * side, np.full((2, 3, 1), z)], axis=-1)


def centres():
    """(H, W, 2) of the pixels' centres."""
    return np.stack(np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5), axis=-1)


def projected(matrix, point):
    """Depth after the division, and pixels, of a point."""
    x, y, z, w = matrix @ np.append(point, 1.0)
    return z / w, (0.5 * np.array([x, y]) / w + 0.5) * SIZE


def nearest(picture, lower_left, size):
    """(H, W, 4) of a picture over a rectangle, transparent outside."""
    uv = (centres() - lower_left) / size
    inside = ((uv >= 0) & (uv <= 1)).all(axis=-1)
    height, width = picture.shape[:2]
    column = np.clip((uv[..., 0] * width).astype(int), 0, width - 1)
    row = np.clip((uv[..., 1] * height).astype(int), 0, height - 1)
    return np.where(inside[..., None], picture[row, column], 0.0)


def over(color, below=0.0):
    """What a colour with alpha leaves on what was there: (…, 4)."""
    color = np.asarray(color, np.float64)
    alpha = color[..., 3:]
    rgb = color[..., :3] * alpha + np.broadcast_to(below, color.shape)[..., :3] * (1 - alpha)
    return np.concatenate([rgb, alpha + np.broadcast_to(below, color.shape)[..., 3:] * (1 - alpha)], axis=-1)


def stroke(begin, end, width):
    """(H, W) how much of every pixel a line with round ends covers, its edge one pixel soft."""
    begin, end = np.asarray(begin, float), np.asarray(end, float)
    along, squared = end - begin, float((end - begin) @ (end - begin))
    t = np.clip((centres() - begin) @ along / squared, 0, 1) if squared else np.zeros(SIZE[::-1])
    distance = np.linalg.norm(centres() - begin - t[..., None] * along, axis=-1)
    return np.clip(0.5 * width + 0.5 - distance, 0, 1), t


# ---- flat ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("corner", "size"), [((4, 6), (20, 10)), ((-7, -3), (30, 50)), ((10.2, 8.25), (13.5, 21.5))])
def test_a_picture_lies_in_its_rectangle_texel_by_texel(drawing, corner, size):
    picture = textures.upload(PICTURE)
    with Window() as window:
        drawing.draw_flat(picture, corner, size)
    np.testing.assert_allclose(window.pixels(), over(nearest(PICTURE, corner, size)), atol=1e-6)


def test_a_second_picture_fills_the_right_of_the_split(drawing):
    other = np.dstack([1 - PICTURE[..., :3] * 0.5, PICTURE[..., 3]])
    with Window() as window:
        drawing.draw_flat(textures.upload(PICTURE), (4, 4), (40, 30), textures.upload(other), split=0.25)
    left = centres()[..., :1] < 0.25 * SIZE[0]
    wanted = np.where(left, nearest(PICTURE, (4, 4), (40, 30)), nearest(other, (4, 4), (40, 30)))
    np.testing.assert_allclose(window.pixels(), over(wanted), atol=1e-6)


def test_a_part_of_a_picture_fills_its_rectangle(drawing):
    width = PICTURE.shape[1] // 2
    with Window() as window:
        drawing.draw_flat(textures.upload(PICTURE[:, : 2 * width]), (30, 2), (20, 16), part=(0.0, 0.5))
        drawing.draw_flat(textures.upload(PICTURE[:, : 2 * width]), (4, 6), (20, 10), part=(0.5, 1.0))
    wanted = nearest(PICTURE[:, width : 2 * width], (4, 6), (20, 10)) + nearest(PICTURE[:, :width], (30, 2), (20, 16))
    np.testing.assert_allclose(window.pixels(), over(wanted), atol=1e-6)


def test_stripes_lie_over_texels_of_alpha_below_one_alone_and_can_be_left_out(drawing):
    marked = np.float32([[[0.8, 0.9, 0.7, 0.5], [0.8, 0.9, 0.7, 1.0]]])
    pictures = []
    for stripes in (0.0, 10.0):
        with Window() as window:
            drawing.draw_flat(textures.upload(marked), (0, 0), SIZE, stripes=stripes)
        pictures.append(window.pixels()[..., :3])
    plain, striped = pictures
    np.testing.assert_allclose(plain, np.broadcast_to(np.float32([0.8, 0.9, 0.7]), plain.shape), atol=1e-6)
    changed = np.abs(striped - plain).max(axis=-1) > 0.2
    middle = SIZE[0] // 2
    assert not changed[:, middle:].any()
    assert 0.3 < changed[:, :middle].mean() < 0.5
    np.testing.assert_array_equal(changed[1:, 1 : middle - 1], changed[:-1, 2:middle])  # diagonal


def test_opacity_blends_with_the_background(drawing):
    with Window() as window:
        drawing.draw_triangles2d(np.array(UNIT_SQUARE) * SIZE, (0.1, 0.2, 0.3, 1))
        drawing.draw_flat(textures.upload(PICTURE), (4, 6), (20, 10), opacity=0.25)
    faint = nearest(PICTURE, (4, 6), (20, 10)) * (1, 1, 1, 0.25)
    np.testing.assert_allclose(window.pixels(), over(faint, (0.1, 0.2, 0.3, 1)), atol=1e-6)


def test_triangles_have_the_colours_of_their_corners(drawing):
    colors = [(1, 0, 0, 1), (0, 1, 0, 1), (0, 0, 1, 1)]
    corners = np.array([[2, 3], [40, 5], [10, 30]], float)
    with Window() as window:
        drawing.draw_triangles2d(corners, colors)
    matrix = np.concatenate([corners.T, np.ones((1, 3))])
    weights = np.concatenate([centres(), np.ones((*SIZE[::-1], 1))], axis=-1) @ np.linalg.inv(matrix).T
    inside = (weights >= 0).all(axis=-1)
    clear = np.abs(weights).min(axis=-1) > 0.01
    found = window.pixels()
    np.testing.assert_allclose(found[inside & clear, :3], weights[inside & clear], atol=2e-3)
    assert not found[~inside & clear].any() and inside.sum() > 300


# ---- lines and points --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("width", [1.0, 3.0, 7.5])
@pytest.mark.parametrize("line", [((5, 20.5), (40, 20.5)), ((6.5, 3), (6.5, 30)), ((4, 5), (39, 28))])
def test_a_line_has_its_width_in_pixels(drawing, line, width):
    colors = np.array([(1, 0.5, 0, 1), (0, 0.5, 1, 0.5)])
    with Window() as window:
        drawing.draw_lines(line, colors, width)
    covered, t = stroke(*line, width=width)
    wanted = colors[0] + (colors[1] - colors[0]) * t[..., None]
    wanted[..., 3] *= covered
    np.testing.assert_allclose(window.pixels(), over(wanted), atol=2e-4)
    assert window.pixels()[..., 3].max() > 0.4


def test_a_strip_goes_through_all_points_and_pairs_do_not(drawing):
    points = [[5, 5], [25, 5], [25, 25], [40, 30]]
    with Window() as strip:
        drawing.draw_lines(points, (1, 1, 1, 1), 2, strip=True)
    with Window() as pairs:
        drawing.draw_lines(points, (1, 1, 1, 1), 2)
    middle = (slice(14, 16), slice(24, 26))  # of the second line, from (25, 5) to (25, 25)
    assert (strip.pixels()[(*middle, 3)] > 0.9).all() and not pairs.pixels()[(*middle, 3)].any()
    for one in (strip, pairs):
        assert one.pixels()[4:6, 10:20, 3].min() > 0.9


@pytest.mark.parametrize("size", [1.0, 6.0, 13.0])
def test_a_point_is_a_disc_of_its_size(drawing, size):
    with Window() as window:
        drawing.draw_points([[20.0, 16.5]], (0.3, 0.6, 0.9, 1), size)
    covered, _ = stroke((20, 16.5), (20, 16.5), size)
    wanted = np.concatenate([np.broadcast_to((0.3, 0.6, 0.9), (*covered.shape, 3)), covered[..., None]], axis=-1)
    np.testing.assert_allclose(window.pixels(), over(wanted), atol=1e-5)


@pytest.mark.parametrize("matrix", [PERSPECTIVE, ORTHOGRAPHIC], ids=["perspective", "orthographic"])
def test_points_in_space_follow_the_matrix_and_keep_their_size(drawing, matrix):
    places = np.array([[0.4, -0.3, 0.0], [-1.0, 0.6, 2.0], [-0.5, -0.6, -8.0]])
    colors = np.eye(4)[:3] + (0, 0, 0, 1)
    with Window() as window:
        drawing.draw_points(places, colors, 5, matrix)
    for place, color in zip(places, colors, strict=True):
        _, pixel = projected(matrix, place)
        covered, _ = stroke(pixel, pixel, 5)
        found = window.pixels()[..., :3] @ color[:3]
        np.testing.assert_allclose(found, covered, atol=5e-4)


@pytest.mark.parametrize("turn", [1, -1])
def test_a_line_past_the_eye_is_clipped_at_the_near_plane(drawing, turn):
    ahead, behind = np.array([0.5, 0.25, 0.0]), np.array([0.5, 0.25, 20.0])
    with Window() as window:
        drawing.draw_lines([ahead, behind][::turn], (1, 1, 1, 1), 3, PERSPECTIVE)
        drawing.draw_lines([behind, behind + (1, 0, 0)], (1, 0, 0, 1), 9, PERSPECTIVE)
    cut = np.array([0.5, 0.25, 5 - NEAR])
    covered, _ = stroke(projected(PERSPECTIVE, ahead)[1], projected(PERSPECTIVE, cut)[1], 3)
    np.testing.assert_allclose(window.pixels(), covered[..., None] * np.ones(4), atol=1e-3)


def test_no_points_draw_nothing(drawing):
    with Window() as window:
        drawing.draw_points(np.zeros((0, 2)), (1, 1, 1, 1), 5)
        drawing.draw_lines(np.zeros((0, 2)), (1, 1, 1, 1), 5)
        drawing.draw_lines([[3, 4]], (1, 1, 1, 1), 5, strip=True)
        drawing.draw_triangles2d(np.zeros((0, 2)), (1, 1, 1, 1))
    assert not window.pixels().any()


# ---- surfaces ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("matrix", [PERSPECTIVE, ORTHOGRAPHIC], ids=["perspective", "orthographic"])
def test_a_surface_shows_the_texels_at_its_uvs(surface, matrix):
    model = np.diag([1.5, 0.8, 1, 1])
    model[:3, 3] = 0.2, -0.1, 1.0
    with Window() as window:
        surface(square()).draw(textures.upload(PICTURE), matrix, model)
    low, high = (projected(matrix, model[:3, :3] @ (x, x, 0) + model[:3, 3])[1] for x in (-1, 1))
    np.testing.assert_allclose(window.pixels(), over(nearest(PICTURE, low, high - low)), atol=1e-6)


def test_nothing_is_drawn_where_the_uv_leaves_the_picture(surface):
    picture = np.ones((2, 2, 4), np.float32)
    with Window() as window:
        surface(square(), 3 * QUAD - 1).draw(textures.upload(picture), ORTHOGRAPHIC, np.eye(4))
    low, high = (projected(ORTHOGRAPHIC, (x, x, 0))[1] for x in (-1 / 3, 1 / 3))
    np.testing.assert_allclose(window.pixels(), nearest(picture, low, high - low), atol=1e-6)


@pytest.mark.parametrize("matrix", [PERSPECTIVE, ORTHOGRAPHIC], ids=["perspective", "orthographic"])
@pytest.mark.parametrize(("scene", "seen"), [(0.2, False), (0.0, True), (-0.2, True)])
def test_the_scene_hides_what_lies_behind_but_not_its_own_surface(surface, drawing, matrix, scene, seen):
    picture = textures.upload(np.ones((1, 1, 4), np.float32))
    depth, _ = projected(matrix, (0, 0, scene))
    point = [[0.0, 0.0, 0.0]]
    for draw in (
        lambda **how: surface(square()).draw(picture, matrix, np.eye(4), **how),
        lambda **how: drawing.draw_points(point, (1, 1, 1, 1), 9, matrix, **({"depth": True} | how)),
        lambda **how: drawing.draw_lines(point * 2, (1, 1, 1, 1), 9, matrix, **({"depth": True} | how)),
    ):
        with Window(depth) as window:
            draw()
        assert (window.pixels()[18, 24, 3] > 0) == seen
        with Window(depth) as window:
            draw(depth=False)
        assert window.pixels()[18, 24, 3] == 1


@pytest.mark.parametrize("order", [[0.0, 1.0], [1.0, 0.0]])
def test_the_near_side_of_a_surface_hides_its_far_side(surface, order):
    layers = np.concatenate([square(z) for z in order])
    uvs = np.concatenate([np.full((2, 3, 2), 0.25 if z == 1 else 0.75) for z in order])
    picture = np.zeros((2, 2, 4), np.float32)
    picture[0, 0], picture[1, 1] = (0, 1, 0, 1), (1, 0, 0, 1)
    with Window() as window:
        surface(layers, uvs).draw(textures.upload(picture), PERSPECTIVE, np.eye(4))
    np.testing.assert_array_equal(window.pixels()[18, 24], (0, 1, 0, 1))


def test_a_hole_in_the_picture_shows_what_is_behind(surface):
    layers, uvs = (
        np.concatenate([square(1.0), square(0.0)]),
        np.concatenate([np.full((2, 3, 2), u) for u in (0.2, 0.8)]),
    )
    picture = np.zeros((2, 2, 4), np.float32)
    picture[1, 1] = (1, 0, 0, 1)
    with Window() as window:
        surface(layers, uvs).draw(textures.upload(picture), PERSPECTIVE, np.eye(4))
    np.testing.assert_array_equal(window.pixels()[18, 24], (1, 0, 0, 1))


@pytest.mark.parametrize("matrix", [PERSPECTIVE, ORTHOGRAPHIC], ids=["perspective", "orthographic"])
def test_the_pull_toward_the_viewer_is_a_thousandth_of_the_way(matrix):
    for z in (3.0, 0.0, -20.0):
        place = np.array([0.3, -0.2, z])
        # To the eye at (0, 0, 5), or along its axis by a thousandth of half the width of 6.
        nearer = place + (np.array([0, 0, 5.0]) - place) * 1e-3 if matrix is PERSPECTIVE else place + (0, 0, 3e-3)
        x, y, depth, w = matrix @ np.append(place, 1.0)
        pulled = (depth + toward_viewer(matrix)) / w
        assert pulled == pytest.approx(projected(matrix, nearer)[0], abs=2e-6 * abs(1 - pulled))
        assert pulled < depth / w


# ---- the drawing state -------------------------------------------------------------------------------------------


def test_the_drawing_state_is_restored(drawing, surface):
    import gpu

    picture = textures.upload(PICTURE)
    for depth, mask, blend in (("NONE", False, "NONE"), ("GREATER", True, "ADDITIVE")):
        with Window():
            gpu.state.depth_test_set(depth)
            gpu.state.depth_mask_set(mask)
            gpu.state.blend_set(blend)
            surface(square()).draw(picture, PERSPECTIVE, np.eye(4))
            drawing.draw_flat(picture, (0, 0), (5, 5))
            drawing.draw_lines([[0, 0], [9, 9]], (1, 1, 1, 1), 2)
            drawing.draw_points([[0, 0]], (1, 1, 1, 1), 2)
            drawing.draw_triangles2d(5 * np.array(UNIT_SQUARE), (1, 1, 1, 1))
            found = gpu.state.depth_test_get(), gpu.state.depth_mask_get(), gpu.state.blend_get()
            assert found == (depth, mask, blend)
            assert viewport_size() == SIZE
    gpu.state.depth_test_set("NONE")
    gpu.state.depth_mask_set(False)
    gpu.state.blend_set("NONE")


def test_a_drawing_that_was_closed_draws_again(drawing):
    for _ in range(2):
        with Window() as window:
            drawing.draw_points([[20, 20]], (1, 1, 1, 1), 8)
            drawing.draw_triangles2d(5 * np.array(UNIT_SQUARE), (1, 1, 1, 1))
            drawing.draw_flat(textures.upload(PICTURE), (30, 3), (5, 5))
        assert window.pixels()[20, 20, 3] == window.pixels()[2, 2, 3] == window.pixels()[4, 31, 3] == 1
        drawing.close()
