"""HEIC files by pillow-heif's encoder, for the tests."""

import io

import numpy as np


def heic(codes, bits=8, exif=b"", icc=b"", transfer=13):
    """Return the bytes of a HEIC file of codes (H, W, 3) of 8 or 10 bits, top row first, as a camera stores them.

    exif: a TIFF block; its orientation is also written into the container, as phones do. transfer: a code of H.273.
    """
    import pillow_heif

    height, width = codes.shape[:2]
    values = codes.astype(np.uint8) if bits == 8 else (codes << 6).astype(np.uint16)
    file = pillow_heif.from_bytes("RGB" if bits == 8 else "RGB;16", (width, height), values.tobytes())
    made = io.BytesIO()
    extra = {"exif": b"Exif\0\0" + exif} if exif else {}
    extra |= {"icc_profile": icc} if icc else {"transfer_characteristics": transfer}
    file.save(made, quality=100, chroma=444, **extra)
    return made.getvalue()
