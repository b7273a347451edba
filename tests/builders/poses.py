"""Files of cameras as COLMAP, Metashape and AliceVision write them, and the pixels of their camera models."""

import json

import numpy as np

WIDTH, HEIGHT = 640, 480
# The camera of all files: world to camera as in computer vision (x right, y down, z forward), and its position (3,).
ROTATION = np.array([[0.36, -0.8, 0.48], [0.48, 0.6, 0.64], [-0.8, 0.0, 0.6]])
CENTRE = np.array([2.0, -1.5, 0.75])
RNG = np.random.default_rng(3)
# Points up to 25° off its axis.
SEEN = np.c_[RNG.uniform(-0.45, 0.45, (12, 2)), np.ones(12)] * RNG.uniform(2, 6, (12, 1))
POINTS = SEEN @ ROTATION + CENTRE
POSE = "1 0 0 0 1 2 3"  # of a line of COLMAP's images.txt


def quaternion(rotation):
    """Return (w, x, y, z) of a rotation (3, 3) whose trace is above −1."""
    w = np.sqrt(1 + np.trace(rotation)) / 2
    r = rotation
    return np.array([w, *(np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]]) / (4 * w))])


def row(values):
    return " ".join(repr(float(value)) for value in np.ravel(values))


def assert_sees(camera, pixels, points=POINTS, atol=1e-9):
    """The points fall on pixels (N, 2) that count from the upper left corner."""
    found, depth = camera.project(np.asarray(points))
    assert (depth > 0).all()
    np.testing.assert_allclose(np.c_[found[:, 0], camera.height - found[:, 1]], pixels, atol=atol)


# ---- COLMAP


def colmap(folder, model="PINHOLE", parameters="500 510 330.5 236.25", images=None, count=None, points="1 2 -1"):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cameras.txt").write_text(
        "# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
        f"# Number of cameras: 1\n7 {model} {WIDTH} {HEIGHT} {parameters}\n"
    )
    pose = row([*quaternion(ROTATION), *(-ROTATION @ CENTRE)])
    images = [f"1 {pose} 7 IMG_0001.JPG"] if images is None else images
    lines = "".join(f"{line}\n{points}\n" for line in images)
    head = f"# Number of images: {len(images) if count is None else count}, mean observations per image: 2\n"
    (folder / "images.txt").write_text(f"# Image list with two lines of data per image:\n{head}{lines}")
    return folder


COLMAP_LENSES = {
    "SIMPLE_PINHOLE": (500, 330.5, 236.25),
    "PINHOLE": (500, 510, 330.5, 236.25),
    "SIMPLE_RADIAL": (500, 330.5, 236.25, -0.11),
    "RADIAL": (500, 330.5, 236.25, -0.11, 0.06),
    "OPENCV": (500, 510, 330.5, 236.25, -0.11, 0.06, 0.004, -0.003),
    "FULL_OPENCV": (500, 510, 330.5, 236.25, -0.11, 0.06, 0.004, -0.003, 0.02, 0.05, -0.01, 0.005),
}


def colmap_pixels(model, parameters):
    """Return POINTS' pixels by COLMAP's camera models; (0.5, 0.5) is the centre of the upper left pixel."""
    values = list(parameters)
    focal = [values[0]] * 2 if model in ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL") else values[:2]
    rest = values[1:] if focal[0] == values[0] and len(values) in (3, 4, 5) and model != "PINHOLE" else values[2:]
    centre, (k1, k2, p1, p2, k3, k4, k5, k6) = rest[:2], (*rest[2:], *[0] * (10 - len(rest)))
    pixels = []
    for x, y, z in (POINTS - CENTRE) @ ROTATION.T:
        u, v = x / z, y / z
        r2 = u * u + v * v
        radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
        pixels.append((
            focal[0] * (u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u)) + centre[0],
            focal[1] * (v * radial + 2 * p2 * u * v + p1 * (r2 + 2 * v * v)) + centre[1],
        ))  # fmt: skip
    return pixels


# ---- Metashape

TERMS = {"f": 500, "cx": 10.5, "cy": -3.75, "b1": 4, "k1": -0.11, "k2": 0.06, "k3": 0.02, "p1": 0.004, "p2": -0.003}
TURN = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
SHIFT, SCALE = np.array([5.0, -6.0, 7.0]), 2.5
COMPONENT = f"""<components><component id="0"><transform><rotation locked="true">{row(TURN)}</rotation>
<translation>{row(SHIFT)}</translation><scale>{SCALE}</scale></transform></component></components>"""
CHUNK = COMPONENT.replace('<components><component id="0">', "").replace("</component></components>", "")


def metashape(path, terms=TERMS, world="", kind="frame", transform=None, camera="", head="", reference=""):
    """Write the XML of Metashape's Export Cameras: matrices camera to chunk, row by row."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = ROTATION.T, CENTRE
    transform = row(matrix) if transform is None else transform
    items = "".join(f"<{name}>{value}</{name}>" for name, value in terms.items())
    path.write_text(
        f"""<?xml version="1.0" encoding="UTF-8"?>{head}
<document version="2.0.0"><chunk label="Chunk 1" enabled="true"><sensors next_id="1">
<sensor id="0" label="Body, 50 mm" type="{kind}"><resolution width="{WIDTH}" height="{HEIGHT}"/>
<calibration type="{kind}" class="initial"><f>1</f></calibration>
<calibration type="{kind}" class="adjusted"><resolution width="{WIDTH}" height="{HEIGHT}"/>{items}</calibration>
</sensor></sensors>{world}<cameras next_id="4"><group id="0"><camera id="0" sensor_id="0" component_id="0"
label="IMG_0001"><transform>{transform}</transform></camera></group>
<camera id="1" sensor_id="0" label="IMG_0002" enabled="false"><transform>{row(matrix)}</transform></camera>
<camera id="2" sensor_id="0" label="IMG_0003"/>{camera}</cameras>{reference}</chunk></document>""",
        encoding="utf-8",
    )
    return path


def metashape_pixels(t):
    """Return POINTS' pixels by Metashape's manual, appendix Camera models, frame cameras."""
    pixels = []
    for px, py, pz in (POINTS - CENTRE) @ ROTATION.T:
        x, y = px / pz, py / pz
        r = np.hypot(x, y)
        radial = 1 + t["k1"] * r**2 + t["k2"] * r**4 + t["k3"] * r**6
        xd = x * radial + t["p1"] * (r**2 + 2 * x**2) + 2 * t["p2"] * x * y
        yd = y * radial + t["p2"] * (r**2 + 2 * y**2) + 2 * t["p1"] * x * y
        pixels.append((WIDTH * 0.5 + t["cx"] + xd * t["f"] + xd * t["b1"], HEIGHT * 0.5 + t["cy"] + yd * t["f"]))
    return pixels


# ---- AliceVision

TURNED = np.diag([1.0, -1.0, -1.0])


def alicevision(path, version=(1, 2, 6), intrinsics=None, pose=None, view=None, **more):
    """Write a .sfm file of an AliceVision version: every number a string, matrices column by column."""
    millimetres = {"sensorWidth": "36", "sensorHeight": "27", "focalLength": repr(500 / WIDTH * 36), "pixelRatio": "1"}
    scale = millimetres if version >= (1, 2, 2) else {"pxFocalLength": ["500", "500"]}
    if version < (1, 2, 0):
        scale = {"pxFocalLength": "500"}
    middle = (0, 0) if version >= (1, 2, 1) else (WIDTH / 2, HEIGHT / 2)
    table = {
        "version": [str(number) for number in version],
        "views": [
            {"viewId": "11", "poseId": "21", "intrinsicId": "31", "path": "/scan/IMG_0001.JPG", "width": str(WIDTH)},
            {"viewId": "12", "poseId": "22", "intrinsicId": "31", "path": "/scan/IMG_0002.JPG", **(view or {})},
        ],
        "intrinsics": [{
            "intrinsicId": "31", "width": str(WIDTH), "height": str(HEIGHT), "type": "radial3", **scale,
            "principalPoint": [str(middle[0] + 10.5), str(middle[1] - 3.75)],
            "distortionParams": ["-0.11", "0.06", "0.02"], **(intrinsics or {}),
        }],
        "poses": [{"poseId": "21", "pose": {"transform": {
            "rotation": [repr(float(v)) for v in ROTATION.T.ravel()], "center": [repr(float(v)) for v in CENTRE],
            **(pose or {}),
        }, "locked": "0"}}],
        **more,
    }  # fmt: skip
    path.write_text(json.dumps(table))
    return path


def alicevision_pixels(k1=0.0, k2=0.0, k3=0.0, t1=0.0, t2=0.0):
    """Return POINTS' pixels by AliceVision's camera models, whose whole numbers are the centres of pixels."""
    pixels = []
    for x, y, z in (POINTS - CENTRE) @ ROTATION.T:
        u, v = x / z, y / z
        r2 = u * u + v * v
        bend = k1 * r2 + k2 * r2**2 + k3 * r2**3
        du = u * bend + t2 * (r2 + 2 * u * u) + 2 * t1 * u * v
        dv = v * bend + t1 * (r2 + 2 * v * v) + 2 * t2 * u * v
        pixels.append((500 * (u + du) + WIDTH / 2 + 10.5, 500 * (v + dv) + HEIGHT / 2 - 3.75))
    return np.array(pixels) + 0.5  # from the corner of the first pixel
