"""Small captures, meshes and .blend files for the tests of the command line, and a call of it in this process."""

import contextlib
import io
from pathlib import Path

import numpy as np

from irpso_addon.capture.camera import Camera
from irpso_addon.capture.images.exr import read_exr
from irpso_addon.capture.types import Capture, Light, Observation
from irpso_addon.capture.write import write_capture
from tests.oracles import reflectance as oracles

VIEW = np.array([0.0, 0.0, 1.0])
MODELS = Path(__file__).resolve().parents[1] / "gpu" / "models"


def run_cli(*arguments):
    """Run the command line in this process; return exit code, standard output and standard error of Python."""
    from irpso_addon import cli

    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = cli.main([str(argument) for argument in arguments])
    return code, out.getvalue(), err.getvalue()


def dome_lights(count=24, widest=55.0):
    """Return (count, 3) unit directions on a spiral from the zenith to ``widest`` degrees off it."""
    theta = np.radians(widest) * np.sqrt((np.arange(count) + 0.5) / count)
    phi = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


def smooth_maps(shape, ranges, seed=0, tilt=25.0):
    """Return asymmetric maps: a normal, "base_color", and the scalars of ``ranges`` (name → (low, high)).

    Normals tilt up to about ``tilt`` degrees. Row 0 is at the bottom.
    """
    rng = np.random.default_rng(seed)
    y, x = np.meshgrid(np.linspace(0, 1, shape[0]), np.linspace(0, 1, shape[1]), indexing="ij")

    def wave():
        a, b, c = rng.uniform(1, 4, 3)
        return 0.5 + 0.5 * np.sin(a * x + b * y + 2 * c) * np.cos(b * x * y + c)

    slope = np.tan(np.radians(tilt)) / np.sqrt(2)
    normal = oracles.unit(np.stack([slope * (2 * wave() - 1), slope * (2 * wave() - 1), np.ones(shape)], axis=-1))
    values = {"base_color": np.stack([0.15 + 0.6 * wave() for _ in range(3)], axis=-1), "normal": normal}
    # A corner of another colour reveals every flip and transposition.
    values["base_color"][: shape[0] // 3, : shape[1] // 4] = (0.7, 0.1, 0.05)
    return values | {name: low + (high - low) * wave() for name, (low, high) in ranges.items()}


def render_oracle(model, values, lights):
    """Return (K, H, W, 3) float64 radiance of the card, seen from straight above."""
    return np.stack([oracles.MODELS[model](values, light, VIEW) for light in lights])


def write_card(folder, images, lights, mask=None):
    """Write images (K, H, W, 3), row 0 at the bottom, as a capture of a flat card; return the folder."""
    height, width = images.shape[1:3]

    def reader(image):
        return lambda: np.concatenate([image, np.ones((height, width, 1))], axis=-1).astype(np.float32)

    shots = tuple(
        Observation(f"light {k}", reader(image), Light(tuple(map(float, light))))
        for k, (image, light) in enumerate(zip(images, lights, strict=True))
    )
    mask = np.ones((height, width), bool) if mask is None else mask
    camera = Camera.orthographic(width, height, 2.0)
    write_capture(Capture(Path(folder).name, shots, (camera,), (mask,)), folder)
    return Path(folder)


def read_map(path):
    """Return (H, W, C), row 0 at the bottom, of an EXR with one part."""
    (channels,) = read_exr(path).values()
    names = next(names for names in ("RGBA", "RGB", "Y", "XYZ") if set(names) == set(channels))
    return np.stack([channels[name] for name in names], axis=-1)


def angle(a, b):
    """Return the angle between unit vectors in degrees, precise for small angles."""
    return np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(np.asarray(a, np.float64) - b, axis=-1) / 2, 0, 1)))


def listing(folder):
    """Return relative path → (bytes, modification time) of everything below a folder."""
    return {
        str(path.relative_to(folder)): (path.stat().st_size, path.stat().st_mtime_ns) if path.is_file() else None
        for path in Path(folder).rglob("*")
    }


def save_scene(path, build):
    """Write a .blend file of an empty scene after ``build(bpy)``; return its path."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    build(bpy)
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True, check_existing=False)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return Path(path)


def add_mesh(bpy, name, vertices, faces, uvs=None):
    """Add a mesh object to the scene; uvs: (corners, 2), or None for no UV map."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(np.asarray(vertices, float).tolist(), [], faces)
    if uvs is not None:
        mesh.uv_layers.new(name="UVMap").data.foreach_set("uv", np.asarray(uvs, np.float32).ravel())
    thing = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(thing)
    return thing


def add_camera(bpy, name="Camera", place=(0, 0, 4), toward=(0, 0, 0), **settings):
    """Add a camera that looks at a point, upright (+Z is up, or +Y where it looks along Z), and make it the scene's."""
    from mathutils import Matrix, Vector

    data = bpy.data.cameras.new(name)
    for key, value in settings.items():
        setattr(data, key, value)
    thing = bpy.data.objects.new(name, data)
    z = (Vector(place) - Vector(toward)).normalized()
    x = Vector((0, 1, 0) if abs(z.z) > 0.99 else (0, 0, 1)).cross(z).normalized()
    thing.matrix_world = Matrix.Translation(place) @ Matrix((x, z.cross(x), z)).transposed().to_4x4()
    bpy.context.scene.collection.objects.link(thing)
    bpy.context.scene.camera = thing
    return thing
