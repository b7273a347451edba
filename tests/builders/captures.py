"""Small captures, and a PNG reader and writer that need zlib only, for the tests of capture/."""

import struct
import zlib
from pathlib import Path

import numpy as np

from irpso_addon.capture import Picture, write_exr

# Five unit lights about the z axis.
LIGHTS = np.array([[0, 0, 1], [0.6, 0, 0.8], [-0.6, 0, 0.8], [0, 0.6, 0.8], [0, -0.6, 0.8]])


def write_png(path, codes, bits=8, extra=b""):
    """Write integer codes (H, W, C), top row first, unfiltered."""
    height, width, channels = codes.shape
    rows = codes.astype(">u2" if bits == 16 else "u1")
    raw = b"".join(b"\0" + row.tobytes() for row in rows)
    kind = {1: 0, 2: 4, 3: 2, 4: 6}[channels]
    header = struct.pack(">IIBBBBB", width, height, bits, kind, 0, 0, 0)
    Path(path).write_bytes(
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + extra + chunk(b"IDAT", zlib.compress(raw)) + chunk(b"IEND", b"")
    )


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def read_png(path):
    """Return (codes (H, W, C), top row first, bits) of a PNG with filters None or Sub; every checksum is checked."""
    data, at, pixels = Path(path).read_bytes(), 8, b""
    while at < len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        body = data[at + 8 : at + 8 + length]
        assert struct.unpack_from(">I", data, at + 8 + length)[0] == zlib.crc32(kind + body)
        if kind == b"IHDR":
            width, height, bits, colour = struct.unpack_from(">IIBB", body)
        pixels += body if kind == b"IDAT" else b""
        at += 12 + length
    channels = {0: 1, 4: 2, 2: 3, 6: 4}[colour]
    step = channels * bits // 8
    lines = np.frombuffer(zlib.decompress(pixels), np.uint8).reshape(height, -1)
    rows = []
    for line in lines:
        assert line[0] in (0, 1)
        body = line[1:].reshape(width, step)
        rows.append(np.cumsum(body, axis=0, dtype=np.uint8) if line[0] else body)
    return np.ascontiguousarray(rows).view(">u2" if bits == 16 else "u1").reshape(height, width, channels), bits


def decode_png(path):
    """Decode a PNG without Blender: a decoder for read_capture."""
    codes, bits = read_png(path)
    return Picture((codes[::-1] / (2**bits - 1)).astype(np.float32), bits)


def sphere(size=48):
    """Return normals (H, W, 3), row 0 at the bottom, and mask of a ball."""
    x, y = np.meshgrid(*[(np.arange(size) + 0.5) / size * 2.2 - 1.1] * 2)
    mask = x**2 + y**2 < 0.95
    z = np.sqrt(np.where(mask, 1 - x**2 - y**2, 1))
    return np.stack([x, y, z], axis=-1) * mask[..., None], mask


def shade(normals, lights=LIGHTS, albedo=0.8):
    """Return Lambertian frames (K, H, W) without cast shadows."""
    return albedo * np.maximum(np.einsum("hwc,kc->khw", normals, lights), 0)


def write_diligent(folder, frames=None, lights=LIGHTS, mask=None, half=False):
    """Write frames (K, H, W) or (K, H, W, 3) as a DiLiGenT folder of EXR files; return the folder."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    if frames is None:
        normals, mask = sphere(24)
        frames = shade(normals, lights)
    frames = frames if frames.ndim == 4 else np.repeat(frames[..., None], 3, axis=-1)
    for k, frame in enumerate(frames):
        write_exr(folder / f"{k:03d}.exr", {"": {c: frame[..., i] for i, c in enumerate("RGB")}}, half)
    (folder / "filenames.txt").write_text("".join(f"{k:03d}.exr\n" for k in range(len(frames))))
    np.savetxt(folder / "light_directions.txt", lights, fmt="%.8f")
    if mask is not None:
        write_exr(folder / "mask.exr", {"": {"Y": mask.astype(np.float32)}})
    return folder
