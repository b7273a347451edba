"""EXIF blocks and raw files written byte by byte, for the tests."""

import struct

import numpy as np

# XYZ of D65 to linear sRGB (IEC 61966-2-1): the matrix of a Rec. 709 camera.
XYZ_TO_REC709 = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])
ASCII, BYTE, SHORT, LONG, RATIONAL, SRATIONAL = 2, 1, 3, 4, 5, 10


def directory(tags, at, order="<"):
    """Return a TIFF directory at offset ``at``. tags: (number, kind, values); rationals are pairs."""
    codes = {BYTE: "B", ASCII: "B", SHORT: "H", LONG: "I", RATIONAL: "I", SRATIONAL: "i"}
    entries, extra = b"", b""
    beyond = at + 2 + 12 * len(tags) + 4
    for number, kind, values in sorted(tags):
        flat = [v for pair in values for v in pair] if kind in (RATIONAL, SRATIONAL) else list(values)
        raw = struct.pack(f"{order}{len(flat)}{codes[kind]}", *flat)
        if len(raw) > 4:
            place = struct.pack(order + "I", beyond + len(extra))
            extra += raw + b"\0" * (len(raw) % 2)
        else:
            place = raw.ljust(4, b"\0")
        entries += struct.pack(order + "HHI", number, kind, len(values)) + place
    return struct.pack(order + "H", len(tags)) + entries + bytes(4) + extra


def exif(seconds=None, f_number=None, iso=None, order="<", orientation=1, focal_35mm=None, size=None, time=None):
    """Return an EXIF block (a TIFF structure) with exposure and lens in its own directory; rationals as pairs.

    time: as in "2026:05:01 12:00:07.25".
    """
    head = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(order + "I", 8)
    first = [(274, SHORT, [orientation]), (34665, LONG, [8 + 2 + 24 + 4])]
    tags = [(33434, RATIONAL, [seconds])] if seconds else []
    tags += [(33437, RATIONAL, [f_number])] if f_number else []
    tags += [(34855, SHORT, [iso])] if iso else []
    tags += [(41989, SHORT, [focal_35mm])] if focal_35mm else []
    if time:
        date, _, part = time.encode().partition(b".")
        tags += [(36867, ASCII, date + b"\0"), (37521, ASCII, part + b"\0")]
    tags += [(40962, LONG, [size[0]]), (40963, LONG, [size[1]])] if size else []
    return head + directory(first, 8, order) + directory(tags, 8 + 2 + 24 + 4, order)


def jpeg(width, height, block=b""):
    """Return the bytes of a grey JPEG file without pixels, with an EXIF block."""
    segment = b"Exif\0\0" + block
    frame = b"\xff\xc2" + struct.pack(">HBHHB", 11, 8, height, width, 1) + bytes(3)
    head = b"\xff\xd8\xff\xe1" + struct.pack(">H", 2 + len(segment)) + segment
    return head + frame + b"\xff\xda\0\2 data\xff\xd9"


def dng(mosaic, black=0, white=65535, neutral=(1.0, 1.0, 1.0), orientation=1, seconds=None, matrix=XYZ_TO_REC709):
    """Return a DNG 1.4 file of a mosaic (H, W) of 16-bit codes, pattern RGGB, of a camera with Rec. 709 primaries.

    Codes (H, W, 3) make a linear DNG, whose pixels have all three colours. matrix: (3, 3), of XYZ to another camera's.
    """
    height, width = mosaic.shape[:2]
    channels = mosaic.size // (height * width)
    pattern = [(33421, SHORT, [2, 2]), (33422, BYTE, [0, 1, 1, 2])] if channels == 1 else []
    tags = [
        (254, LONG, [0]), (256, LONG, [width]), (257, LONG, [height]), (258, SHORT, [16] * channels), (259, SHORT, [1]),
        (262, SHORT, [32803 if pattern else 34892]), (271, ASCII, b"Test\0"), (272, ASCII, b"Camera\0"),
        (274, SHORT, [orientation]), (277, SHORT, [channels]), (278, LONG, [height]), (279, LONG, [2 * mosaic.size]),
        *pattern, (50706, BYTE, [1, 4, 0, 0]), (50708, ASCII, b"Test Camera\0"),
        (50714, SHORT, [black] * channels), (50717, SHORT, [white] * channels), (50778, SHORT, [21]),
        (50721, SRATIONAL, [(round(v * 10**4), 10**4) for v in matrix.ravel()]),
        (50728, RATIONAL, [(round(v * 10**4), 10**4) for v in neutral]),
    ]  # fmt: skip
    tags += [(33434, RATIONAL, [seconds])] if seconds else []
    start = 8 + len(directory([*tags, (273, LONG, [0])], 8))
    body = directory([*tags, (273, LONG, [start])], 8)
    return b"II*\0" + struct.pack("<I", 8) + body + mosaic.astype("<u2").tobytes()


def tiff(codes, tags=(), colour_space=None):
    """Return an uncompressed TIFF file of codes (H, W, C), top row first. tags: more of (number, kind, values).

    colour_space: ColorSpace of its EXIF directory.
    """
    height, width, channels = codes.shape
    data = codes.astype(codes.dtype.newbyteorder("<")).tobytes()
    kept = {
        256: (LONG, [width]), 257: (LONG, [height]), 258: (SHORT, [8 * codes.itemsize] * channels), 259: (SHORT, [1]),
        262: (SHORT, [2 if channels >= 3 else 1]), 277: (SHORT, [channels]), 278: (LONG, [height]),
        279: (LONG, [len(data)]), **{number: (kind, values) for number, kind, values in tags},
    }  # fmt: skip
    places = {273: (LONG, [0])} if colour_space is None else {273: (LONG, [0]), 34665: (LONG, [0])}
    inner = b"" if colour_space is None else directory([(40961, SHORT, [colour_space])], 0)
    listed = [(number, *rest) for number, rest in (kept | places).items()]
    end = 8 + len(directory(listed, 8))
    places = {273: (LONG, [end + len(inner)]), 34665: (LONG, [end])}
    listed = [(number, *places.get(number, rest)) for number, *rest in listed]
    return b"II*\0" + struct.pack("<I", 8) + directory(listed, 8) + inner + data


def bayer(rgb):
    """Return the RGGB mosaic (H, W) of (H, W, 3)."""
    mosaic = rgb[..., 1].copy()
    mosaic[::2, ::2], mosaic[1::2, 1::2] = rgb[::2, ::2, 0], rgb[1::2, 1::2, 2]
    return mosaic
