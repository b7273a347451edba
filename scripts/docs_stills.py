"""Makes the guide's pictures that need no window: the sample capture, its lights, its recovery and its asset.

make_stills() runs the program's commands, opens the web page in Chromium, and caches results in a folder; `make
docs-images` calls it.
"""

from __future__ import annotations

import subprocess
import sys
import tomllib
from contextlib import closing
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))
from tests.builders.browser import Browser, chromium  # noqa: E402

IMAGES = ROOT / "docs" / "images"
CROP, DISTANCE = (
    (25, 51, 378, 378),
    508,
)  # the tile's rectangle in the photographs, and its distance from the camera: README.txt of the sample
SHOWN = "IMG_0003.jpg"
QUALITY = 76  # of JPEG
ENLARGED = 1.5  # scale of the chart
INK, PAPER, ACCENT, LIGHT = "#d8d8d8", "#1d1d1d", "#e8a33d", "#ffe9a8"  # colours of drawings, as in the program
ASSET = """
import sys, bpy
with bpy.data.libraries.load(sys.argv[-2]) as (there, here):
    here.materials = there.materials
preview = here.materials[0].preview
import numpy, PIL.Image
size = preview.image_size
pixels = numpy.array(preview.image_pixels_float[:]).reshape(size[1], size[0], 4)[::-1]
PIL.Image.fromarray((pixels * 255).clip(0, 255).astype("uint8")).save(sys.argv[-1])
"""


def run(*words: object) -> None:
    """Run a command of the program. Raises SystemExit with its output if it fails."""
    done = subprocess.run(
        [sys.executable, "-m", "irpso_addon", *map(str, words)], cwd=ROOT, capture_output=True, text=True
    )
    if done.returncode:
        raise SystemExit(f"irpso {' '.join(map(str, words))}\n{done.stdout}{done.stderr}")


def prepare(work: Path) -> None:
    """Render the sample, find its lights, recover it and save it as an asset; skip steps with a result in ``work``."""
    sample, capture, result = work / "sample", work / "capture", work / "result"
    if not (sample / "README.txt").is_file():
        run("sample", "-o", sample)
    if not (capture / "capture.toml").is_file():
        run("calibrate", sample / "photographs", "--radius", 20, "--lamp-distance", 950, "-o", capture)
    if not (result / "report.json").is_file():
        crop = ",".join(map(str, CROP))
        run("recover", capture, "--distance", DISTANCE, "--crop", crop, "--hold-out", "auto", "-o", result)
    if not (work / "asset.png").is_file():
        run("export", result, "--format", "asset", "-o", work / "library", "--asset-name", "Tile")
        command = [sys.executable, "-c", ASSET, work / "library" / "Tile.blend", work / "asset.png"]
        subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)


def runs(line: np.ndarray, paper: np.ndarray, least: int) -> list[tuple[int, int]]:
    """Return [(start, end)] of pictures in a row of pixels (N, 3): at least ``least`` pixels that are not paper."""
    inked = np.abs(line.astype(int) - paper).max(axis=1) > 2
    stretches, start, gap = [], None, 0
    for index, full in enumerate([*inked, *[False] * 5]):
        gap = 0 if full else gap + 1
        start = index if full and start is None else start
        if start is not None and gap == 5:  # dark lines inside a picture are thinner
            stretches += [(start, index - gap + 1)] if index - gap + 1 - start >= least else []
            start = None
    return stretches


def cells(sheet: Image.Image, size: int) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """Return the columns and rows of pictures of ``size`` pixels in a sheet of the program."""
    pixels = np.asarray(sheet)
    top = next(y for y in range(sheet.height) if runs(pixels[y], pixels[0, 0], size - 4))
    columns = runs(pixels[top + size // 4], pixels[0, 0], size - 4)
    rows = runs(pixels[:, (columns[0][0] + columns[0][1]) // 2], pixels[0, 0], size - 4)
    return columns, rows


def relit(work: Path) -> Image.Image:
    """Return a held-out photograph beside the maps under its light, from the program's sheet."""
    sheet = Image.open(work / "result" / "relit.png").convert("RGB")
    columns, rows = cells(sheet, CROP[2])
    parts = [sheet.crop((left, rows[0][0], right, rows[0][1])) for left, right in columns[:2]]
    return beside(parts, gap=8)


def preview(work: Path) -> Image.Image:
    """Return the first row of preview.png, with headings and scale."""
    sheet = Image.open(work / "result" / "preview.png").convert("RGB")
    _, rows = cells(sheet, CROP[2])
    part = sheet.crop((0, 0, sheet.width, (rows[0][1] + rows[1][0]) // 2 + 8))
    return narrowed(part, 760)


def photograph(work: Path) -> Image.Image:
    """Return one of the sample's photographs."""
    return Image.open(work / "sample" / "photographs" / SHOWN).convert("RGB")


def places(work: Path) -> dict:
    """Return the table of ball, tile and chart in the photographs."""
    return tomllib.loads((work / "sample" / "truth" / "places.toml").read_text(encoding="utf-8"))


def sample(work: Path) -> Image.Image:
    """Return a photograph beside the recovered base colour, normal, roughness and metallic."""
    left = narrowed(photograph(work), 296)
    names = ("base_color", "normal", "roughness", "metallic")
    maps = [narrowed(picture_of(work / "result" / f"{name}.png"), 109) for name in names]
    return beside([left, stacked([beside(maps[:2], 4), beside(maps[2:], 4)], 4)], 4)


def picture_of(path: Path) -> Image.Image:
    """Return a map of 8 or 16 bits as a picture."""
    values = np.asarray(Image.open(path))
    return Image.fromarray((values / 257).astype(np.uint8) if values.dtype != np.uint8 else values).convert("RGB")


def balls(work: Path) -> Image.Image:
    """Return the detected ball with its highlights, and the lights on the hemisphere."""
    return narrowed(Image.open(work / "capture" / "balls.png").convert("RGB"), 680)


def mask(work: Path) -> Image.Image:
    """Return a photograph beside the mask of its ball."""
    shown = photograph(work)
    x, y, radius = places(work)["ball"]
    painted = Image.new("RGB", shown.size, "black")
    ImageDraw.Draw(painted).ellipse((x - radius, y - radius, x + radius, y + radius), fill="white")
    return beside([narrowed(one, 300) for one in (shown, painted)], 4)


def chart(work: Path) -> Image.Image:
    """Return the chart in a photograph, with its corners numbered in the order of --colour-chart."""
    corners = np.array(places(work)["chart"])
    low, high = corners.min(axis=0) - 34, corners.max(axis=0) + 34
    part = photograph(work).crop((*low.astype(int), *high.astype(int))).rotate(-90, expand=True)
    part = narrowed(part, round(ENLARGED * part.width))
    draw, font = ImageDraw.Draw(part), ImageFont.load_default(18)
    for number, (x, y) in enumerate(corners - low.astype(int), 1):
        place = np.array(
            (part.width - ENLARGED * y, ENLARGED * x)
        )  # rotated clockwise, so that patch 1 is the upper left one
        draw.ellipse((*(place - 6), *(place + 6)), outline=ACCENT, width=3)
        outward = np.sign(place - np.array(part.size) / 2) * 18
        draw.text(tuple(place + outward), str(number), fill=ACCENT, font=font, anchor="mm")
    return part


def narrowed(picture: Image.Image, width: int) -> Image.Image:
    """Return a picture of another width, its height in proportion."""
    return picture.resize((width, round(width * picture.height / picture.width)), Image.Resampling.LANCZOS)


def beside(parts: list[Image.Image], gap: int) -> Image.Image:
    """Return pictures of one height side by side."""
    sheet = Image.new("RGB", (sum(p.width for p in parts) + gap * (len(parts) - 1), parts[0].height), PAPER)
    left = 0
    for part in parts:
        sheet.paste(part, (left, 0))
        left += part.width + gap
    return sheet


def stacked(parts: list[Image.Image], gap: int) -> Image.Image:
    """Return pictures of one width below each other."""
    return beside([part.transpose(Image.Transpose.TRANSPOSE) for part in parts], gap).transpose(
        Image.Transpose.TRANSPOSE
    )


def asset(work: Path) -> Image.Image:
    """Return the asset's preview on the grey of Blender's asset browser."""
    shown = Image.open(work / "asset.png")
    sheet = Image.new("RGBA", shown.size, "#2b2b2b")
    sheet.alpha_composite(shown)
    return sheet.convert("RGB")


def web(work: Path) -> Image.Image:
    """Return the web page of the result in Chromium, a photograph beside the render under its light."""
    run("export", work / "result", "--format", "web", "-o", work / "web")
    with closing(Browser(900, 640)) as browser:
        browser.scheme("dark")
        browser.open(work / "web" / "index.html", "photograph=1")
        return narrowed(Image.fromarray(browser.screenshot()), 600)


class Drawing:
    """Shapes of a drawing to scale in two views, from the side and from above; places in millimetres."""

    MIDDLES = {"side": (215, 318), "above": (640, 190)}
    SCALE = 0.23  # pixels a millimetre

    def __init__(self):
        self.shapes: list[str] = []

    def place(self, view: str, x: float, y: float, z: float) -> tuple[float, float]:
        """Return the pixel of a point in a view. z: up from the table."""
        right, up = self.MIDDLES[view]
        return round(right + self.SCALE * x, 1), round(up - self.SCALE * (z if view == "side" else y), 1)

    def dot(self, at: tuple[float, float], radius: float, style: str) -> None:
        """Add a circle."""
        self.shapes.append(f'<circle cx="{at[0]}" cy="{at[1]}" r="{radius:g}" {style}/>')

    def line(self, start: tuple[float, float], end: tuple[float, float], style: str) -> None:
        """Add a line."""
        self.shapes.append(f'<line x1="{start[0]}" y1="{start[1]}" x2="{end[0]}" y2="{end[1]}" {style}/>')

    def word(self, at: tuple[float, float], text: str, anchor: str = "middle") -> None:
        """Add a text."""
        self.shapes.append(f'<text x="{at[0]:g}" y="{at[1]:g}" text-anchor="{anchor}">{text}</text>')

    def svg(self) -> str:
        """Return the SVG file's text."""
        box = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 860 370" font-family="sans-serif" font-size="13"'
        paper = f'<rect width="860" height="370" rx="6" fill="{PAPER}"/>'
        return "\n".join([f'{box} fill="{INK}">', paper, *self.shapes, "</svg>", ""])


def rig(work: Path) -> str:
    """Return an SVG to scale: camera, tile, ball and the lamp's positions, from the side and from above."""
    table = tomllib.loads((work / "sample" / "truth" / "capture.toml").read_text(encoding="utf-8"))
    scene, high = places(work), table["card_distance"]
    # Positions are in camera axes, and the camera looks down; the drawing's heights are above the tile.
    lamps = [shot["light_position"] for shot in table["observation"]]
    ball = (*scene["ball_centre"][:2], high + scene["ball_centre"][2])
    millimetres = scene["ball_radius"] / scene["ball"][2] * -scene["ball_centre"][2] / high  # a pixel on the card
    corners = (np.array(scene["tile"]) - np.array(photograph(work).size) / 2) * (millimetres, -millimetres)
    (left, low), (right, up) = corners.min(axis=0), corners.max(axis=0)
    drawing = Drawing()
    for view in drawing.MIDDLES:
        x, y = drawing.place(view, left, up, 0)
        height = 5 if view == "side" else drawing.SCALE * (up - low)
        box = f'x="{x}" y="{y}" width="{drawing.SCALE * (right - left):.1f}" height="{height:.1f}"'
        drawing.shapes.append(f'<rect {box} fill="#3f8f86"/>')
        style = f'fill="none" stroke="{INK}" stroke-width="1.5"'
        drawing.dot(drawing.place(view, *ball), drawing.SCALE * scene["ball_radius"], style)
        for lamp in lamps:
            drawing.dot(drawing.place(view, lamp[0], lamp[1], lamp[2] + high), 4, f'fill="{LIGHT}"')
    string = drawing.place("side", *ball), drawing.place("side", lamps[3][0], lamps[3][1], lamps[3][2] + high)
    drawing.line(*string, f'stroke="{ACCENT}" stroke-dasharray="4 3"')
    x, y = drawing.place("side", 0, 0, high)
    drawing.shapes.append(f'<path d="M{x - 16} {y - 22}h32v16h-10l-3 6h-6l-3 -6h-10z" fill="{INK}"/>')
    table_top = drawing.MIDDLES["side"][1] + 5
    drawing.line((x, y), (x, table_top), f'stroke="{INK}" stroke-dasharray="2 4"')
    drawing.line((20, table_top), (410, table_top), f'stroke="{INK}"')
    drawing.word((x - 8, (y + table_top) / 2), f"camera, {high:.0f} mm above", "end")
    drawing.word(
        ((string[0][0] + string[1][0]) / 2 + 14, (string[0][1] + string[1][1]) / 2 + 30), "string, 950 mm", "start"
    )
    x, y = drawing.place("above", *ball)
    drawing.word((x + 10, y - 8), "ball", "start")
    drawing.word(
        (drawing.place("above", (left + right) / 2, low, 0)[0], drawing.place("above", 0, low, 0)[1] + 18), "tile"
    )
    drawing.word((20, 26), f"{len(lamps)} places of one lamp", "start")
    drawing.word((drawing.MIDDLES["side"][0], 355), "from the side")
    drawing.word((drawing.MIDDLES["above"][0], 355), "from above")
    return drawing.svg()


PICTURES = {
    "relit": relit, "preview": preview, "sample": sample, "balls": balls, "mask": mask, "chart": chart, "asset": asset,
    "web": web,
}  # fmt: skip


def make_stills(work: Path, images: Path = IMAGES, only: tuple[str, ...] = ()) -> list[Path]:
    """Write the pictures, or those named in ``only``, into ``images``; return their paths. work: folder of results."""
    if (not only or "web" in only) and not chromium():
        raise SystemExit("Missing: chromium, for the picture of the web page. `make browser` installs it")
    prepare(work)
    images.mkdir(parents=True, exist_ok=True)
    made = []
    for name, picture in PICTURES.items():
        if not only or name in only:
            made.append(images / f"{name}.jpg")
            picture(work).save(made[-1], quality=QUALITY, optimize=True, progressive=True)
    if not only or "rig" in only:
        made.append(images / "rig.svg")
        made[-1].write_text(rig(work), encoding="utf-8")
    return made
