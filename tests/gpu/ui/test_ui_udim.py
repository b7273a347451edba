"""UDIM tiles and material slots in the window: what a job holds, where tiles are drawn, and what is kept."""

from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from irpso_addon.capture.camera import Camera
from irpso_addon.capture.images.exr import write_exr
from irpso_addon.capture.types import Capture, Light, Observation
from irpso_addon.capture.write import write_capture
from irpso_addon.core.errors import InputError
from irpso_addon.core.udim import tile_part
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.maps import Maps
from irpso_addon.results.write import write_maps
from tests.builders import command_line as cli_maker
from tests.builders.exports import picture

SIDE, PIXELS = 8, 32
LIGHTS = cli_maker.dome_lights(8, widest=50)
TILES = (1001, 1012)
SLOTS = ("Skin", "Cloth")


pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def settings(tmp_path):
    """The settings of a scene with two flat squares in two UDIM tiles, a slot each, and a capture of them."""
    bpy.ops.wm.read_homefile(use_empty=True)
    square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    corners = np.concatenate([square + (-1, -0.5), square + (0, -0.5)])
    vertices = np.concatenate([corners, np.zeros((8, 1))], axis=1)
    thing = cli_maker.add_mesh(bpy, "Two", vertices, [range(4), range(4, 8)], np.concatenate([square, square + 1]))
    for name in SLOTS:
        thing.data.materials.append(bpy.data.materials.new(name))
    thing.data.polygons.foreach_set("material_index", [0, 1])
    bpy.context.view_layer.update()

    def reader(light):
        # Left a grey of .6, right of .3.
        grey = np.where(np.arange(PIXELS) < PIXELS // 2, 0.6, 0.3) * light[2]
        image = np.ones((PIXELS, PIXELS, 4), np.float32)
        image[..., :3] = grey[:, None]
        return lambda: image

    shots = tuple(Observation(f"{k}", reader(light), Light(tuple(map(float, light)))) for k, light in enumerate(LIGHTS))
    matrix = np.eye(4)
    matrix[2, 3] = 3
    camera = Camera(PIXELS, PIXELS, (PIXELS / 2.0,) * 2, (PIXELS / 2,) * 2, matrix, False)
    write_capture(Capture("two", shots, (camera,), (np.ones((PIXELS, PIXELS), bool),)), tmp_path / "capture")
    settings = bpy.context.scene.irpso
    settings.capture_path, settings.subject, settings.object = str(tmp_path / "capture"), "MESH", thing
    settings.model, settings.resolution = "lambert", SIDE
    settings.schedule.iterations = 10
    return settings


def make_job():
    from irpso_addon.ui.session.scene_job import make_job

    return make_job(bpy.context)


def test_a_run_on_udim_tiles_keeps_a_tiled_material_in_all_slots(settings, tmp_path):
    from irpso_addon.ui.session import session

    session.begin(make_job()).run()
    running = session.current()
    try:
        assert running.domain.shape == (SIDE, 2 * SIDE) and running.tiles == TILES
        assert bpy.ops.irpso.keep() == {"FINISHED"}
        thing = bpy.data.objects["Two"]
        assert [slot.material.name for slot in thing.material_slots] == ["IRPSO Two"] * 2
        image = bpy.data.images["IRPSO Two base_color"]
        assert image.source == "TILED" and tuple(tile.number for tile in image.tiles) == TILES
        # What was recovered can be given again, as the tiled image that it became.
        from irpso_addon.ui.session.scene_job import image_map

        found = image_map(image, load_model("lambert"), "base_color", (SIDE, 2 * SIDE), TILES)
        inside = (slice(1, -1), slice(1, SIDE - 1)), (slice(1, -1), slice(SIDE + 1, -1))
        for part, grey in zip(inside, (0.6, 0.3), strict=True):
            np.testing.assert_allclose(found[part], grey, atol=0.01)
        wanted = {"filepath": str(tmp_path / "set"), "format": "textures", "occlusion": True}
        assert bpy.ops.irpso.export(**wanted) == {"FINISHED"}
        for number in TILES:  # two squares in one plane hide nothing from each other
            assert picture(tmp_path / "set" / f"Two_AO.{number}.png").min() > 0.98
        assert len(bpy.data.scenes) == 1
    finally:
        session.end()


def test_only_the_active_slot_is_recovered_and_replaced(settings):
    from irpso_addon.ui.session import session

    thing = bpy.data.objects["Two"]
    settings.slots, thing.active_material_index = "ACTIVE", 1
    session.begin(make_job()).run()
    try:
        running = session.current()
        assert running.job.name == "Two Cloth" and running.tiles == (1012,)
        assert running.domain.shape == (SIDE, SIDE) and running.domain.solvable[1:-1, 1:-1].all()
        assert bpy.ops.irpso.keep() == {"FINISHED"}
        assert [slot.material.name for slot in thing.material_slots] == ["Skin", "IRPSO Two Cloth"]
        assert tuple(tile.number for tile in bpy.data.images["IRPSO Two Cloth base_color"].tiles) == (1012,)
        thing.data.materials.pop()
        with pytest.raises(RuntimeError, match="were 0 'Skin', 1 'Cloth' when .* began, and are 0 'Skin' now"):
            bpy.ops.irpso.keep()
    finally:
        session.end()


def test_a_last_slot_that_no_face_has_may_be_removed_before_keep(settings):
    from irpso_addon.ui.session import session

    thing = settings.object
    thing.data.materials.append(bpy.data.materials.new("unused"))
    settings.slots, thing.active_material_index = "ACTIVE", 1
    session.begin(make_job()).run()
    try:
        thing.data.materials.pop()
        assert bpy.ops.irpso.keep() == {"FINISHED"}
        assert [slot.material.name for slot in thing.material_slots] == ["Skin", "IRPSO Two Cloth"]
        thing.data.materials.pop(index=0)  # Blender gives the faces behind it the slot before theirs
        with pytest.raises(RuntimeError, match="1 'Cloth', 2 'unused' when .* began, and are 0 'IRPSO Two Cloth' now"):
            bpy.ops.irpso.keep()
    finally:
        session.end()


def test_maps_do_not_go_into_slots_or_a_uv_map_that_have_changed(settings, tmp_path):
    from irpso_addon.ui.session import session

    thing, others = settings.object, settings.object.data
    skin, cloth = others.materials
    of_faces = [face.material_index for face in others.polygons]
    settings.slots, thing.active_material_index = "ACTIVE", 1
    session.begin(make_job()).run()
    try:
        for slots in ((cloth, skin), (skin,), ()):
            others.materials.clear()
            for material in slots:
                others.materials.append(material)
            with pytest.raises(RuntimeError, match="slots of 'Two' were 0 'Skin', 1 'Cloth' when its recovery began"):
                bpy.ops.irpso.keep()
            with pytest.raises(RuntimeError, match="restore their order, or recover again"):
                bpy.ops.irpso.export(filepath=str(tmp_path / "two.glb"), format="gltf")
            assert others.materials[:] == list(slots) and not (tmp_path / "two.glb").exists()
        others.materials.clear()
        for material in (skin, skin, bpy.data.materials.new("more")):
            others.materials.append(material)  # another material in the slot, and one more slot, move nothing
        others.update_tag()
        with pytest.raises(RuntimeError, match="all faces of material slot 1 'Cloth' of 'Two' have another slot"):
            bpy.ops.irpso.keep()  # they were set to 0 with the slots
        others.polygons.foreach_set("material_index", of_faces)
        layer = others.uv_layers.active
        layer.name = "Other"
        others.update_tag()
        with pytest.raises(RuntimeError, match="'Two' has no UV map 'UVMap' any more"):
            bpy.ops.irpso.keep()
        layer.name = "UVMap"
        others.update_tag()
        for _ in range(2):
            assert bpy.ops.irpso.keep() == {"FINISHED"}
            assert [slot.name for slot in thing.material_slots] == ["Skin", "IRPSO Two Cloth", "more"]
        others.materials[0], others.materials[1] = others.materials[1], skin
        with pytest.raises(RuntimeError, match="and are 0 'IRPSO Two Cloth', 1 'Skin', 2 'more' now"):
            bpy.ops.irpso.keep()
    finally:
        session.end()


def test_a_uv_map_that_has_moved_since_is_warned_of(settings, tmp_path, capfd):
    from irpso_addon.ui.session import session

    thing, layer = settings.object, settings.object.data.uv_layers.active
    settings.slots, thing.active_material_index = "ACTIVE", 1
    session.begin(make_job()).run()
    told = "the UV map 'UVMap' of 'Two' has changed since its maps were recovered"
    export = {"filepath": str(tmp_path / "two.glb"), "format": "gltf"}
    try:

        def said():
            thing.data.update_tag()
            assert bpy.ops.irpso.keep() == {"FINISHED"} and bpy.ops.irpso.export(**export) == {"FINISHED"}
            return capfd.readouterr().out.count(told)

        assert said() == 0
        layer.uv[0].vector.x += 0.25  # of the slot that was not recovered
        assert said() == 0
        layer.uv[4].vector.x += 0.25
        assert said() == 2
        layer.uv[4].vector.x -= 0.75  # across the border of the tile
        assert said() == 2
        thing.modifiers.new("Finer", "SUBSURF")
        assert said() == 0
    finally:
        session.end()


def test_missing_slots_are_reported_before_anything_is_read(settings):
    from irpso_addon.ui.session.scene_job import missing

    settings.slots = "NAMED"
    assert missing(bpy.context) == "No slot is chosen: name those to be recovered, of 0 'Skin', 1 'Cloth'"
    settings.slot_list = "Cloth, Hair"
    assert missing(bpy.context) == ""
    with pytest.raises(InputError, match="there is no slot 'Hair'; the slots are 0 'Skin', 1 'Cloth'"):
        make_job()
    settings.slot_list = "Cloth, 0"
    assert make_job().mesh.tiles == TILES


def test_another_choice_of_slots_makes_another_domain(settings):
    sources = []
    for settings.slots in ("ALL", "ACTIVE", "ALL"):
        sources.append(make_job().source)
    assert sources[0] == sources[2] != sources[1]


@pytest.mark.parametrize("packed", [False, True])
def test_given_maps_come_from_the_tiles_of_a_tiled_image(settings, tmp_path, packed):
    from irpso_addon.ui.session.scene_job import image_map

    model = load_model("lambert")
    color = np.random.default_rng(1).random((SIDE, 2 * SIDE, 3)).astype(np.float32)
    normal = np.broadcast_to(np.float32((0, 0, 1)), color.shape)
    write_maps(
        Maps(model, {"base_color": color, "normal": normal}, np.ones(color.shape[:2], bool), tiles=TILES),
        tmp_path / "maps",
        {},
    )
    image = bpy.data.images.new("given", 1, 1)
    image.filepath, image.source = str(tmp_path / "maps" / "base_color.<UDIM>.exr"), "TILED"
    image.colorspace_settings.name = "Non-Color"
    if packed:
        image.pack()
        for path in (tmp_path / "maps").iterdir():
            path.unlink()
    count = len(bpy.data.images)
    found = image_map(image, model, "base_color", color.shape[:2], TILES)
    np.testing.assert_array_equal(found, color)
    one = image_map(image, model, "base_color", (SIDE, SIDE), TILES[1:])
    np.testing.assert_array_equal(one, tile_part(color, 1, 2))
    with pytest.raises(InputError, match="has no file for UDIM tile 1002"):
        image_map(image, model, "base_color", color.shape[:2], (1001, 1002))
    assert len(bpy.data.images) == count
    write_exr(tmp_path / "plain.exr", {"": {c: color[..., i] for i, c in enumerate("RGB")}})
    plain = bpy.data.images.load(str(tmp_path / "plain.exr"))
    with pytest.raises(InputError, match="is one picture, the UV map has the UDIM tiles 1001, 1012"):
        image_map(plain, model, "base_color", color.shape[:2], TILES)
    image.pixels[0] = 0.5
    with pytest.raises(InputError, match="image 'given' has unsaved changes; save it in the Image Editor"):
        image_map(image, model, "base_color", color.shape[:2], TILES)


def region(scale=100.0, left=20.0, bottom=10.0):
    """Return an Image editor's region whose unit square is ``scale`` pixels wide and high."""
    return SimpleNamespace(
        view2d=SimpleNamespace(view_to_region=lambda x, y, clip: (left + scale * x, bottom + scale * y))
    )


@pytest.mark.parametrize("show_uvedit", [True, False])
def test_tiles_lie_flat_where_their_texture_coordinates_are(show_uvedit):
    from irpso_addon.ui.overlay import flat

    shape = (4, 2 * 8)  # texels twice as high as wide under texture coordinates
    areas = flat.map_areas(region(), SimpleNamespace(show_uvedit=show_uvedit), shape, TILES)
    up = 100 if show_uvedit else 50
    assert [(a.x, a.y, a.width, a.height) for a in areas] == [(20, 10, 100, up), (120, 10 + up, 100, up)]
    np.testing.assert_allclose(flat.texture_place(areas, 45, 10 + 0.5 * up), (0.125, 0.5))
    np.testing.assert_allclose(flat.texture_place(areas, 195, 10 + 1.25 * up), (0.875, 0.25))
    assert flat.texture_place(areas, 195, 10 + 0.5 * up) is None
    for row, column in ((0, 0), (3, 7), (0, 8), (2, 13)):
        place = flat.flat_place(areas, shape, row, column)
        np.testing.assert_allclose(flat.texture_place(areas, *place), ((column + 0.5) / 16, (row + 0.5) / 4))
    one = flat.map_areas(region(), SimpleNamespace(show_uvedit=True), (4, 8))
    assert (one[0].x, one[0].y, one[0].width, one[0].height) == (20, 10, 100, 100) and len(one) == 1


def test_a_click_finds_only_texels_of_recovered_slots(settings):
    from irpso_addon.ui.overlay import probes

    settings.slots = "ACTIVE"
    bpy.data.objects["Two"].active_material_index = 1
    mesh = make_job().mesh
    running = SimpleNamespace(
        mesh=mesh, tiles=mesh.tiles, domain=SimpleNamespace(shape=(SIDE, SIDE)), job=SimpleNamespace(place=np.eye(4)),
        subject=lambda: bpy.data.objects["Two"],
    )  # fmt: skip
    # From above, orthographic: 4 × 3 units in 800 × 600 pixels.
    view = SimpleNamespace(perspective_matrix=np.diag([2 / 4, 2 / 3, -1 / 10, 1]))

    def clicked(x, y):
        return probes._surface_texel(running, view, (400 + 200 * x, 300 + 200 * y), (800, 600))

    assert clicked(0.3, 0.2) == (int(0.7 * SIDE), int(0.3 * SIDE)) and clicked(0.99, -0.49) == (0, SIDE - 1)
    assert clicked(-0.3, 0.2) is None and clicked(1.2, 0) is None


@pytest.mark.parametrize("packed", [False, True])
def test_an_image_follows_the_tiles_and_takes_no_file_of_former_ones(settings, tmp_path, packed):
    from irpso_addon.blender.materials.material import build_material

    model, folder = load_model("lambert"), None if packed else tmp_path / "images"
    for tiles in ((1001, 1012), (1001, 1002, 1003), (1003,), (1001,), (1002, 1012)):
        shape = (4, 4 * len(tiles))
        values = {p.name: np.tile(np.float32(p.default), (*shape, 1)) for p in model.parameters}
        values["base_color"][:] = (np.arange(shape[1]) // 4 * 0.1 + 0.25)[:, None]
        build_material(Maps(model, values, np.ones(shape, bool), tiles=tiles), "set", folder)
        (image,) = (image for image in bpy.data.images if image.name == "IRPSO set base_color")
        assert image.source == ("FILE" if tiles == (1001,) else "TILED")
        assert tuple(tile.number for tile in image.tiles) == tiles
        assert (image.packed_file is not None) == packed and len(image.packed_files) == packed * len(tiles)
        from irpso_addon.ui.session.scene_job import image_map

        found = image_map(image, model, "base_color", shape, tiles)
        np.testing.assert_allclose(found, values["base_color"], atol=2e-5)
