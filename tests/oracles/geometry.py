"""Oracles of the geometry: meshes made in numpy, and brute-force rasterisers in float64."""

import numpy as np

from irpso_addon.geometry.surface.bake import SurfaceBake
from irpso_addon.geometry.surface.mesh import MeshData
from tests.oracles.reflectance import unit

EDGE = -1e-9  # a centre exactly on an edge is inside, whatever the rounding of the weights


def mesh_from_grid(surface, normal, columns, rows, uv=lambda u, v: (u, v)):
    """Return a mesh of 2 · columns · rows triangles over (u, v) in 0…1: surface and normal give (…, 3) for u, v."""
    u, v = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1))
    low = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
    corners = np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]])
    index = (low[:, None, None] + corners[None]).reshape(-1, 3, 2)
    u, v = u[index[..., 1], index[..., 0]], v[index[..., 1], index[..., 0]]
    step = 1e-5
    along = surface(u + step, v) - surface(u - step, v)
    up = surface(u, v + step) - surface(u, v - step)
    # At a pole the derivative along u vanishes.
    n, t = unit(normal(u, v)), unit(np.where(np.linalg.norm(along, axis=-1, keepdims=True) > 0, along, (1, 0, 0)))
    sign = np.sign(np.einsum("...i,...i", np.cross(n, t), up))
    return mesh_from_corners(surface(u, v), n, np.concatenate([t, sign[..., None]], -1), np.stack(uv(u, v), -1))


def mesh_from_corners(positions, normals, tangents, uvs):
    """Return a mesh of float32 corners."""
    arrays = [np.asarray(a, np.float32) for a in (positions, normals, tangents, uvs)]
    return MeshData("test", *arrays, np.zeros(len(positions), np.int32), "UVMap", np.eye(4))


def joined(*meshes):
    """Return one mesh of all triangles."""
    parts = [np.concatenate([getattr(m, k) for m in meshes]) for k in ("positions", "normals", "tangents", "uvs")]
    return mesh_from_corners(*parts)


def sphere(radius=1.0, columns=48, rows=24, centre=(0, 0, 0)):
    """Return a sphere whose first texture coordinate is the longitude."""

    def direction(u, v):
        a, b = 2 * np.pi * u, np.pi * (v - 0.5)
        return np.stack([np.cos(a) * np.cos(b), np.sin(a) * np.cos(b), np.sin(b)], -1)

    return mesh_from_grid(lambda u, v: radius * direction(u, v) + np.asarray(centre), direction, columns, rows)


def plane(size=2.0, z=0.0, columns=4, rows=4, u_span=(0.0, 1.0)):
    """Return a square facing +z whose first texture coordinate runs over u_span."""

    def surface(u, v):
        return np.stack([size * (u - 0.5), size * (v - 0.5), np.full_like(u, z)], -1)

    def texture(u, v):
        return u_span[0] + u * (u_span[1] - u_span[0]), v

    return mesh_from_grid(surface, lambda u, v: np.zeros((*u.shape, 3)) + (0, 0, 1), columns, rows, texture)


def bake_uv(mesh, width, height):
    """Return a float64 bake of the UV square and the distance, in texels, of each centre from the nearest edge."""
    centres = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), -1).reshape(-1, 1, 2)
    a, b, c = (mesh.uvs[None, :, k].astype(np.float64) * (width, height) for k in range(3))
    weights, distance = _weights(a, b, c, centres)
    return _surface(mesh, weights, np.where((weights >= EDGE).all(-1), 0.0, np.inf), distance, height, width)


def bake_camera(mesh, camera):
    """Return a float64 ray-cast bake of a camera (Möller, Trumbore 1997), and the pixels' distance from edges."""
    points = camera.points(1.0).reshape(-1, 1, 3)
    origin = camera.position if camera.perspective else points + 1e3 * camera.backward
    ray = points - camera.position if camera.perspective else np.broadcast_to(-camera.backward, points.shape)
    a, b, c = (mesh.positions[None, :, k].astype(np.float64) for k in range(3))
    e1, e2 = b - a, c - a
    p = np.cross(ray, e2)
    det = (e1 * p).sum(-1)
    det = np.where(np.abs(det) < 1e-14, np.inf, det)
    s = origin - a
    q = np.cross(s, e1)
    second, third, along = (s * p).sum(-1) / det, (ray * q).sum(-1) / det, (e2 * q).sum(-1) / det
    weights = np.stack([1 - second - third, second, third], -1)
    depth = np.where((weights >= EDGE).all(-1) & (along > 0) & np.isfinite(det), along, np.inf)
    if camera.perspective and not (camera.project(mesh.positions)[1] > 0).all():
        distance = np.full(weights.shape[:2], np.inf)
    else:
        centres = np.stack(np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5), -1)
        pixels = camera.project(mesh.positions.astype(np.float64))[0]
        distance = _weights(*(pixels[None, :, k] for k in range(3)), centres.reshape(-1, 1, 2))[1]
    return _surface(mesh, weights, depth, distance, camera.height, camera.width)


def _weights(a, b, c, p):
    def cross(x, y):
        return x[..., 0] * y[..., 1] - x[..., 1] * y[..., 0]

    area = cross(b - a, c - a)
    area = np.where(area == 0, np.inf, area)
    weights = np.stack([cross(b - p, c - p), cross(c - p, a - p), cross(a - p, b - p)], -1) / area[..., None]
    lengths = np.stack([np.linalg.norm(x, axis=-1) for x in (c - b, a - c, b - a)], -1)
    real = np.isfinite(area)
    heights = np.where(real, np.abs(area), 0)[..., None] / np.maximum(lengths, 1e-30)
    # Far from the triangle the distance to its lines is meaningless.
    near = real & (weights * heights > -0.1).all(-1)
    return weights, np.where(near, np.abs(weights * heights).min(-1), np.inf)


def _surface(mesh, weights, depth, distance, height, width):
    chosen = depth.argmin(1)
    rows = np.arange(len(chosen))
    covered = np.isfinite(depth[rows, chosen])
    w = weights[rows, chosen][..., None]
    corner = {k: getattr(mesh, k)[chosen].astype(np.float64) for k in ("positions", "normals", "tangents", "uvs")}
    blended = {k: np.where(covered[:, None], (v * w).sum(1), 1.0) for k, v in corner.items()}
    n = unit(blended["normals"])
    t = blended["tangents"][:, :3]
    t = unit(t - n * (n * t).sum(-1, keepdims=True))
    p = mesh.positions[chosen].astype(np.float64)
    e1, e2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    face = np.cross(e1, e2)
    collapsed = np.linalg.norm(face, axis=-1) <= 1e-5 * np.linalg.norm(e1, axis=-1) * np.linalg.norm(e2, axis=-1)
    face = unit(np.where(collapsed[:, None], n, face))
    face *= np.where((face * n).sum(-1, keepdims=True) < 0, -1, 1)
    parts = (blended["positions"], n, np.concatenate([t, corner["tangents"][:, 0, 3:]], -1))
    keep = covered[:, None]
    position, normal, tangent = (np.where(keep, part, 0).reshape(height, width, -1) for part in parts)
    bake = SurfaceBake(
        position=position,
        normal=normal,
        tangent=tangent,
        coverage=covered.reshape(height, width),
        uv=np.where(keep, blended["uvs"], 0).reshape(height, width, 2),
        face_normal=np.where(keep, face, 0).reshape(height, width, 3),
        triangle=np.where(covered, chosen, -1).reshape(height, width).astype(np.int32),
    )
    return bake, distance.min(1).reshape(height, width)
