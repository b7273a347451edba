"""ICC profiles written byte by byte, and pictures that embed them, for the tests."""

import struct
import zlib

import numpy as np

from tests.builders.captures import chunk

# Bradford-adapted colorants of published profiles, XYZ relative to D50: columns red, green, blue.
P3 = np.array([[0.51512, 0.29198, 0.15710], [0.24120, 0.69225, 0.06657], [-0.00105, 0.04189, 0.78407]])
ADOBE_RGB = np.array([[0.60974, 0.20528, 0.14919], [0.31111, 0.62567, 0.06322], [0.01947, 0.06087, 0.74457]])
PROPHOTO = np.array([[0.79767, 0.13519, 0.03134], [0.28804, 0.71188, 0.00009], [0.0, 0.0, 0.82491]])
SRGB_CURVE = (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)


def parametric(kind, numbers):
    fixed = [round(v * 65536) for v in numbers]
    return b"para" + bytes(4) + struct.pack(">HH", kind, 0) + struct.pack(f">{len(fixed)}i", *fixed)


def table(values):
    return b"curv" + bytes(4) + struct.pack(">I", len(values)) + struct.pack(f">{len(values)}H", *values)


def icc(colorants=P3, curve=None, space=b"RGB ", extra=None, name="Test P3"):
    """Return a matrix/TRC profile; curve: the data of its curve tags; extra: further tags."""
    curve = parametric(3, SRGB_CURVE) if curve is None else curve
    text = name.encode("utf-16-be")
    words = b"mluc" + bytes(4) + struct.pack(">II2s2sII", 1, 12, b"en", b"US", len(text), 28) + text
    xyz = lambda v: b"XYZ " + bytes(4) + struct.pack(">3i", *(round(float(x) * 65536) for x in v))  # noqa: E731
    tags = {b"desc": words, b"wtpt": xyz((0.9642, 1.0, 0.8249)), b"cprt": words}
    if space == b"GRAY":
        tags[b"kTRC"] = curve
    elif colorants is not None:
        for letter, column in zip("rgb", colorants.T, strict=True):
            tags[f"{letter}XYZ".encode()], tags[f"{letter}TRC".encode()] = xyz(column), curve
    tags |= extra or {}
    start, rows, data = 132 + 12 * len(tags), b"", b""
    for tag, body in tags.items():
        rows += struct.pack(">4sII", tag, start + len(data), len(body))
        data += body + bytes(-len(body) % 4)
    body = struct.pack(">I", len(tags)) + rows + data
    head = struct.pack(">I4sI4s4s4s", 128 + len(body), b"lcms", 0x04300000, b"mntr", space, b"XYZ ")
    head += struct.pack(">6H4s", 2026, 1, 1, 0, 0, 0, b"acsp") + bytes(28)
    head += struct.pack(">3i", 63190, 65536, 54061)
    return head.ljust(128, b"\0") + body


def png_icc(profile):
    """Return the iCCP chunk of a profile."""
    return chunk(b"iCCP", b"profile\0\0" + zlib.compress(profile))
