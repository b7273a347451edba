"""Runs inside Blender, for the pictures of the guide: a head to be recovered, and a capture of it with cast shadows."""

import importlib
import math

import bpy
import numpy as np
from mathutils import Euler, Vector
from mathutils.bvhtree import BVHTree

PROGRAM = "bl_ext.user_default.irpso.irpso_addon"
LIGHTS, WIDEST = 40, 68.0  # how many, and degrees off the camera's axis
HEIGHT, ASPECT = 420, 1.2  # pixels; width over height
TURN, TILT, DISTANCE, LENS = 16.0, 4.0, 8.6, 106.0  # of the camera: degrees, degrees, metres, millimetres
PROBED = ((0.0, -0.75, 0.62), (0.35, -0.85, 0.25), (0.05, -0.9, -0.55), (0.55, -0.55, 0.45))  # places on the head
GOLDEN = math.pi * (3 - math.sqrt(5))


def part(name):
    """Return a module of the program."""
    return importlib.import_module(f"{PROGRAM}.{name}")


def build_scene():
    """Put head and camera into the open file, in the place of all that was there; return the head's object."""
    for obj in list(bpy.data.objects):
        bpy.data.objects.remove(obj)
    bpy.ops.mesh.primitive_monkey_add(size=2.0, calc_uvs=True)
    head = bpy.context.active_object
    head.modifiers.new("Subdivision", "SUBSURF").levels = 2
    head.modifiers["Subdivision"].render_levels = 2
    head.data.shade_smooth()
    turn = Euler((math.radians(90 - TILT), 0, math.radians(TURN)))
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.lens = LENS
    camera.rotation_euler, camera.location = turn, turn.to_matrix() @ Vector((0, 0, DISTANCE))
    bpy.context.scene.collection.objects.link(camera)
    bpy.context.scene.camera = camera
    bpy.context.view_layer.update()
    return head


def write_capture(head, folder):
    """Photograph the head under lights around the camera, shadows cast by itself included, into a new folder."""
    types, forward, build = part("capture.types"), part("solver.views.forward"), part("geometry.surface.bake")
    mesh = part("blender.mesh").extract_mesh(head)
    view = part("blender.scenes.scene").camera_from_object(bpy.context.scene.camera, round(HEIGHT * ASPECT), HEIGHT)
    lights = [types.Light(tuple(float(v) for v in view.matrix[:3, :3] @ direction)) for direction in spiral()]
    bake = build.bake_camera(mesh, view)
    model = part("reflectance.model").load_model("cook_torrance_two_lobe")
    renderer = forward.camera_renderer(bake, model, part("demo.truth").material_at(bake), view, lights)
    tree = BVHTree.FromPolygons(
        mesh.positions.reshape(-1, 3).tolist(), np.arange(3 * len(mesh.positions)).reshape(-1, 3).tolist()
    )
    noise = np.random.default_rng(1)
    observations = []
    for number, light in enumerate(lights):
        image = renderer.render(number)
        image[..., 3] = 1
        image[in_shadow(tree, bake, light.vector), :3] = 0
        image[..., :3] = np.maximum(image[..., :3] + 0.002 * noise.normal(size=image[..., :3].shape), 0)
        observations.append(types.Observation(f"light {number:02d}", lambda image=image: image, light))
        yield
    renderer.close()
    capture = types.Capture("head", tuple(observations), (view,), (bake.coverage,))
    part("capture.write").write_capture(capture, folder, half=True)


def in_shadow(tree, bake, toward):
    """Return (H, W) bool: what the head itself keeps a light's rays from."""
    toward = Vector(toward)
    shaded = np.zeros(bake.coverage.shape, bool)
    facing = bake.coverage & (bake.normal @ np.array(toward) > 0)
    places = bake.position[facing] + 2e-3 * bake.normal[facing]
    shaded[facing] = [tree.ray_cast(Vector(place), toward)[0] is not None for place in places.tolist()]
    return shaded


def spiral():
    """Return (LIGHTS, 3) unit directions around +Z, even over a cap of the sphere."""
    heights = 1 - (1 - math.cos(math.radians(WIDEST))) * (np.arange(LIGHTS) + 0.5) / LIGHTS
    turns, sines = GOLDEN * np.arange(LIGHTS), np.sqrt(1 - heights**2)
    return np.stack([sines * np.cos(turns), sines * np.sin(turns), heights], axis=-1)


def look(distance=4.6):
    """Turn the 3D viewport to where the camera stands, nearer, and take out of it what is not spoken of."""
    space = largest("VIEW_3D").spaces.active  # noqa: F821  of inside.py
    for name in (
        "show_floor",
        "show_axis_x",
        "show_axis_y",
        "show_cursor",
        "show_text",
        "show_outline_selected",
        "show_extras",
    ):
        setattr(space.overlay, name, False)
    space.show_gizmo = False
    view = space.region_3d
    view.view_perspective = "PERSP"
    view.view_location = (0.0, 0.0, 0.05)
    view.view_rotation = bpy.context.scene.camera.rotation_euler.to_quaternion()
    view.view_distance = distance


def texel(place):
    """Return row and column of the solved texel that is nearest to a place of the world."""
    domain = part("ui.session.session").current().domain
    far = np.linalg.norm(domain.bake.position - np.array(place), axis=-1)
    far[~domain.solvable] = np.inf
    return [int(index) for index in np.unravel_index(far.argmin(), far.shape)]


def lit_by(observation):
    """Light the scene by one light of the capture, and a little from everywhere."""
    bpy.context.scene.irpso.view.observation = observation + 1
    bpy.context.scene.world.color = (0.03, 0.03, 0.03)
    bpy.context.scene.world.use_nodes = False


def rendered_view():
    """Have Cycles draw the viewport, without anything around the head."""
    scene, space = bpy.context.scene, largest("VIEW_3D").spaces.active  # noqa: F821  of inside.py
    scene.render.engine = "CYCLES"
    scene.cycles.preview_samples = 64
    scene.cycles.use_preview_denoising = False
    space.overlay.show_overlays = False
    space.shading.type = "RENDERED"


def solid_view():
    """Have the viewport as it was."""
    space = largest("VIEW_3D").spaces.active  # noqa: F821
    space.overlay.show_overlays = True
    space.shading.type = "SOLID"


def show_preferences():
    """Have the preferences show the add-on's own, opened."""
    bpy.context.preferences.active_section = "ADDONS"
    bpy.context.window_manager.addon_search = "IRPSO"
    bpy.context.window_manager.addon_filter = "All"
    bpy.ops.preferences.addon_expand(module="bl_ext.user_default.irpso")


def waiting(seconds):
    """Let Blender work for some time."""
    import time

    end = time.monotonic() + seconds
    while time.monotonic() < end:
        yield
