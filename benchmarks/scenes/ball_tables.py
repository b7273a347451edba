"""Tables with mirror balls, matte balls, or none, among other objects, rendered by Cycles under single lamps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import bpy  # isort: skip — bmesh is there once bpy is
import bmesh
import numpy as np
from mathutils import Quaternion, Vector

from irpso_addon.blender.scenes.cycles import only_lamp, place_lamp
from irpso_addon.calibration.balls.ball import Ball, tangents
from irpso_addon.capture.camera import Camera
from irpso_addon.capture.images.exr import read_exr

from . import render

WIDTH, HEIGHT, SAMPLES = 960, 720, 2
# Most samples of a ball's pixels: with two, noise decides which pixels at a highlight's border are clipped.
BALL_SAMPLES = 64
WITH = (("mirror",), ("matte",), (), ("mirror", "mirror"), ("matte", "matte"), (), ("mirror", "matte"), ())
_DISTANCE = 10.0  # from the camera to the table
_MIN_DIAMETER, _MAX_DIAMETER = 0.03, 0.30  # diameter of a ball, over the picture's width
_NEAR, _NEAR_DISTANCES = 0.5, (1.2, 4.0)  # share of the scenes with near lamps; their distance, in picture widths
_CLOTH, _CLOTH_ALBEDO = 0.2, (0.003, 0.02)  # share of the scenes on black cloth
_TRIES = 200
_RAYS = 400  # to a ball


@dataclass(frozen=True)
class BallTable:
    """A rendered table. images: (K, H, W, 3) float32 radiance, row 0 at the bottom.

    lamps: (K, 3) unit directions to suns, or positions if ``near``. balls: (kind, centre (3,), radius) each, in camera
    axes, which are the world's. visible: unoccluded part of each ball's disc. cloth: the table is black cloth. text:
    the scene in words.
    """

    images: np.ndarray
    lamps: np.ndarray
    near: bool
    camera: Camera
    balls: tuple[tuple[str, np.ndarray, float], ...]
    visible: tuple[float, ...]
    cloth: bool
    text: str

    def lights(self, centre: np.ndarray) -> np.ndarray:
        """Return (K, 3) unit directions to the lamps from a point (3,)."""
        toward = self.lamps - centre if self.near else self.lamps
        return toward / np.linalg.norm(toward, axis=-1, keepdims=True)


def photographed(seed: int, cache: Path, width: int = WIDTH, samples: int = SAMPLES) -> BallTable:
    """Return the scene of a seed; pictures in ``cache`` are not rendered again."""
    height = width * HEIGHT // WIDTH
    rng = np.random.default_rng(seed)
    fov, tilt = rng.uniform(22, 50), np.radians(rng.choice([0.0, rng.uniform(5, 55)]))
    up = np.array([0.0, np.sin(tilt), np.cos(tilt)])
    camera = Camera.from_fov(width, height, fov)
    lights = _lights(rng, up, int(rng.integers(6, 9)))
    strengths = rng.uniform(0.7, 1.4, len(lights))
    scene = render.empty_scene(render.View(width, height, samples=samples, bounces=3, filter_glossy=0.0))
    scene.render.film_transparent, scene.render.use_persistent_data = False, True
    scene.camera.data.type, scene.camera.data.angle = "PERSP", math.radians(fov)
    scene.camera.location = (0, 0, 0)
    _world(scene, rng)
    near, cloth, away = rng.random() < _NEAR, rng.random() < _CLOTH, _width(fov) * rng.uniform(*_NEAR_DISTANCES)
    words = _table(rng, up, cloth)
    balls = _things(rng, up, fov, WITH[seed // 2 % len(WITH)])
    visible = tuple(_visible(scene, centre, radius) for _, centre, radius in balls)
    wide = math.radians(rng.uniform(1.0, 4.0))
    lamp = only_lamp(scene, "POINT" if near else "SUN", away * math.tan(wide / 2))
    lamps = np.array([0, 0, -_DISTANCE]) + away * lights if near else lights
    if not near:
        lamp.data.angle = wide
    folder = cache / f"balls-{width}-{samples}" / str(seed)
    images = []
    for number, (place, strength) in enumerate(zip(lamps, strengths, strict=True)):
        place_lamp(lamp, place, away)
        lamp.data.energy *= strength
        image = _shot(scene, folder / f"{number}.exr")
        for ball, (_, centre, radius) in enumerate(balls):
            _refine(image, scene, camera, centre, radius, folder / f"{number}-{ball}.exr")
        images.append(image)
    text = (
        f"{' and '.join(kind for kind, _, _ in balls) or 'no ball'}, {words}, tilt {np.degrees(tilt):.0f}°,"
        f" lamps {f'{away / _width(fov):.1f} widths away' if near else 'distant'}"
    )
    return BallTable(np.array(images), lamps, near, camera, tuple(balls), visible, cloth, text)


def _width(fov: float) -> float:
    """Return the width of the picture at the table's middle. fov: degrees."""
    return 2 * _DISTANCE * math.tan(math.radians(fov) / 2)


def _refine(image: np.ndarray, scene, camera: Camera, centre: np.ndarray, radius: float, path: Path) -> None:
    """Render a ball's pixels again with more samples: those of the whole picture, at most ``BALL_SAMPLES`` a pixel."""
    outline = Ball("ball", camera, centre, radius, 1.0, (0.0, 0.0)).outline
    size = np.array([camera.width, camera.height])
    low, high = (np.clip(side, 0, size).astype(int) for side in (outline.min(axis=0) - 3, outline.max(axis=0) + 4))
    made, samples = scene.render, scene.cycles.samples
    made.use_border = made.use_crop_to_border = True
    # A quarter of a pixel more, so that rounding does not move the border.
    made.border_min_x, made.border_min_y = (low + 0.25) / size
    made.border_max_x, made.border_max_y = (high + 0.25) / size
    scene.cycles.samples = min(BALL_SAMPLES, int(samples * size.prod() / (high - low).prod()))
    image[low[1] : high[1], low[0] : high[0]] = _shot(scene, path)
    made.use_border, scene.cycles.samples = False, samples


def _shot(scene, path: Path) -> np.ndarray:
    if not path.is_file():
        scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "16"
        scene.render.filepath = str(path)
        bpy.ops.render.render(write_still=True)
    channels = read_exr(path)[""]
    return np.stack([channels[c] for c in "RGB"], axis=-1).astype(np.float32)


def _lights(rng: np.random.Generator, up: np.ndarray, count: int) -> np.ndarray:
    """Return (count, 3) directions to lamps around the table's normal, 15° to 65° off it."""
    across = np.array([1.0, 0.0, 0.0])
    turn = 2 * np.pi * (np.arange(count) + rng.uniform(0, 0.7, count)) / count
    fall = np.radians(rng.uniform(15, 65, count))[:, None]
    flat = np.cos(turn)[:, None] * across + np.sin(turn)[:, None] * np.cross(up, across)
    return np.cos(fall) * up + np.sin(fall) * flat


def _world(scene, rng: np.random.Generator) -> None:
    """Give the scene a faint environment: a mottled sky."""
    scene.world = bpy.data.worlds.new("world")
    scene.world.use_nodes = True
    scene.world.cycles.sampling_method = "NONE"  # faint: its map costs more than it saves
    tree = scene.world.node_tree
    noise = tree.nodes.new("ShaderNodeTexNoise")
    noise.inputs["Scale"].default_value = rng.uniform(1, 5)
    ramp = tree.nodes.new("ShaderNodeValToRGB")
    ramp.color_ramp.elements[0].position, ramp.color_ramp.elements[1].position = 0.4, 0.65
    tree.links.new(noise.outputs[0], ramp.inputs[0])
    tree.links.new(ramp.outputs[0], tree.nodes["Background"].inputs["Color"])
    tree.nodes["Background"].inputs["Strength"].default_value = rng.choice([0.005, 0.03, 0.1])


def _material(
    color: Sequence[float], roughness: float = 0.8, metallic: float = 0.0, specular: float = 0.5,
    texture: float = 0.0, scale: float = 1.0,
) -> bpy.types.Material:  # fmt: skip
    """Return a Principled material. texture: relative variation of its colour."""
    made = bpy.data.materials.new("material")
    made.use_nodes = True
    tree = made.node_tree
    shader = tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*color, 1)
    shader.inputs["Roughness"].default_value, shader.inputs["Metallic"].default_value = roughness, metallic
    shader.inputs["Specular IOR Level"].default_value = specular
    if texture:
        noise, ramp = tree.nodes.new("ShaderNodeTexNoise"), tree.nodes.new("ShaderNodeValToRGB")
        noise.inputs["Scale"].default_value = scale
        place = tree.nodes.new("ShaderNodeTexCoord")
        tree.links.new(place.outputs["Object"], noise.inputs["Vector"])
        for element, factor, at in zip(ramp.color_ramp.elements, (1 - texture, 1), (0.35, 0.65), strict=True):
            element.color, element.position = (*(factor * c for c in color), 1), at
        tree.links.new(noise.outputs[0], ramp.inputs[0])
        tree.links.new(ramp.outputs[0], shader.inputs["Base Color"])
    return made


def _table(rng: np.random.Generator, up: np.ndarray, cloth: bool) -> str:
    bpy.ops.mesh.primitive_plane_add(size=80, location=(0, 0, -_DISTANCE))
    _turned(bpy.context.object, up)
    albedo = rng.choice([rng.uniform(0.05, 0.2), rng.uniform(0.2, 0.5), rng.uniform(0.5, 0.8)])
    texture = rng.choice([0.0, 0.0, 0.3, 0.6])
    gloss = rng.uniform(0.25, 0.5) if rng.random() < 0.2 and not cloth else 1.0
    if cloth:
        albedo = math.exp(rng.uniform(*np.log(_CLOTH_ALBEDO)))
    color = albedo * rng.uniform(0.7, 1.0, 3)
    bpy.context.object.data.materials.append(
        _material(color, gloss, specular=0.5 if gloss < 1 else 0.0, texture=texture, scale=rng.uniform(0.5, 4))
    )
    words = f"{'cloth' if cloth else 'table'} {albedo:.3f}"
    return words + (", textured" if texture else "") + (", glossy" if gloss < 1 else "")


def _turned(thing: bpy.types.Object, up: np.ndarray, turn: float = 0.0) -> None:
    """Rotate an object: its z axis along ``up``, turned about it."""
    thing.rotation_mode = "QUATERNION"
    thing.rotation_quaternion = Vector(up).to_track_quat("Z", "Y") @ Quaternion((0, 0, 1), turn)


def _things(
    rng: np.random.Generator, up: np.ndarray, fov: float, kinds: Sequence[str]
) -> list[tuple[str, np.ndarray, float]]:
    """Put balls and other objects on free places of the table; return the balls."""
    width = _width(fov)
    taken: list[tuple[np.ndarray, float]] = []
    balls = []
    size = width / 2 * math.exp(rng.uniform(math.log(_MIN_DIAMETER), math.log(_MAX_DIAMETER)))
    for kind in kinds:
        radius = size if len(set(kinds)) == 1 else min(size, 0.1 * width) * rng.uniform(0.7, 1.4)
        foot = _free_place(rng, up, width, radius, taken)
        if foot is not None:
            centre = foot + radius * up
            _ball(rng, kind, centre, radius)
            balls.append((kind, centre, radius))
    for _ in range(int(rng.integers(2, 9))):
        half = width / 2 * rng.uniform(0.03, 0.2)
        foot = _free_place(rng, up, width, half, taken)
        if foot is not None:
            _clutter(rng, up, foot, half)
    return balls


def _free_place(
    rng: np.random.Generator, up: np.ndarray, width: float, radius: float, taken: list[tuple[np.ndarray, float]]
) -> np.ndarray | None:
    """Return a free place on the table inside the picture, and add it to ``taken``; None if there is none."""
    away = np.cross(up, (1.0, 0.0, 0.0))
    for _ in range(_TRIES):
        x, y = rng.uniform(-0.5, 0.5, 2) * (width, width * HEIGHT / WIDTH)
        foot = np.array([0, 0, -_DISTANCE]) + x * np.array([1.0, 0, 0]) + y * away
        centre = foot + radius * up
        scale = _DISTANCE / -centre[2]
        room = np.array([0.49 * width, 0.49 * width * HEIGHT / WIDTH]) - 1.1 * radius * scale
        clear = all(np.linalg.norm(foot - other) > 1.25 * (radius + far) for other, far in taken)
        if clear and (np.abs(scale * centre[:2]) < room).all():
            taken.append((foot, radius))
            return foot
    return None


def _ball(rng: np.random.Generator, kind: str, centre: np.ndarray, radius: float) -> None:
    bpy.ops.mesh.primitive_uv_sphere_add(segments=192, ring_count=96, radius=radius, location=centre)
    bpy.ops.object.shade_smooth()
    if kind == "mirror":
        material = _material(rng.uniform(0.55, 0.95) * rng.uniform(0.9, 1, 3), rng.choice([0.05, 0.12, 0.2]), 1.0)
    else:
        material = _material(rng.uniform(0.3, 0.85) * rng.uniform(0.85, 1, 3), 1.0, specular=0.0)
    bpy.context.object.data.materials.append(material)


def _visible(scene, centre: np.ndarray, radius: float) -> float:
    """Return the part of a ball's disc that is visible from the camera, at the origin."""
    distance = float(np.linalg.norm(centre))
    away = np.sqrt((np.arange(_RAYS) + 0.5) / _RAYS) * radius / math.sqrt(distance**2 - radius**2)
    turn = np.arange(_RAYS) * np.pi * (3 - np.sqrt(5))
    axis = centre / distance
    across, upward = tangents(axis)
    rays = axis + away[:, None] * (np.cos(turn)[:, None] * across + np.sin(turn)[:, None] * upward)
    bpy.context.view_layer.update()
    graph = bpy.context.evaluated_depsgraph_get()
    hits = [scene.ray_cast(graph, (0, 0, 0), Vector(ray).normalized()) for ray in rays]
    return float(np.mean([hit[0] and np.linalg.norm(np.array(hit[1]) - centre) < 1.01 * radius for hit in hits]))


def _clutter(rng: np.random.Generator, up: np.ndarray, foot: np.ndarray, half: float) -> None:
    """Put an object that is no ball onto the table, maybe round, glossy or textured."""
    what = rng.choice(["box", "can", "disc", "cone", "ring", "egg", "head", "bowl"])
    tall = half * rng.uniform(0.3, 1.6)
    if what == "box":
        bpy.ops.mesh.primitive_cube_add(size=2)
        bpy.context.object.scale = (0.7 * half, 0.7 * half * rng.uniform(0.4, 1), tall / 2)
    elif what == "can":
        bpy.ops.mesh.primitive_cylinder_add(vertices=96, radius=half, depth=tall)
    elif what == "disc":
        tall = 0.01 * half
        bpy.ops.mesh.primitive_cylinder_add(vertices=96, radius=half, depth=tall)
    elif what == "cone":
        bpy.ops.mesh.primitive_cone_add(vertices=96, radius1=half, radius2=0, depth=tall)
    elif what == "ring":
        tall = 0.5 * half
        bpy.ops.mesh.primitive_torus_add(
            major_segments=96, minor_segments=32, major_radius=0.75 * half, minor_radius=0.25 * half
        )
    elif what == "egg":
        tall = half
        bpy.ops.mesh.primitive_uv_sphere_add(segments=96, ring_count=48, radius=half)
        bpy.context.object.scale = (1, rng.uniform(0.5, 0.75), 0.5)
    elif what == "head":
        tall = 1.2 * half
        bpy.ops.mesh.primitive_monkey_add(size=1.4 * half)
    else:
        tall = half
        bpy.ops.mesh.primitive_uv_sphere_add(segments=96, ring_count=48, radius=half)
        _upper_half_removed(bpy.context.object)
    thing = bpy.context.object
    thing.location = foot + up * (tall / 2 if what != "bowl" else half)
    _turned(thing, up, rng.uniform(0, 2 * math.pi))
    if what in ("ring", "egg", "head", "bowl"):
        bpy.ops.object.shade_smooth()
    thing.data.materials.append(
        _material(
            rng.uniform(0.05, 0.9, 3), rng.choice([0.1, 0.3, 0.8, 1.0]), rng.choice([0.0, 0.0, 0.0, 1.0]),
            rng.choice([0.0, 0.5]), texture=rng.choice([0.0, 0.5]), scale=2 / half,
        )
    )  # fmt: skip


def _upper_half_removed(ball: bpy.types.Object) -> None:
    mesh = bmesh.new()
    mesh.from_mesh(ball.data)
    bmesh.ops.delete(mesh, geom=[v for v in mesh.verts if v.co.z > 1e-6], context="VERTS")
    mesh.to_mesh(ball.data)
    mesh.free()
