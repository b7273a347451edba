"""Web pages for the tests, of maps and photographs by the oracles, written and opened in Chromium."""

import numpy as np
import pytest

from irpso_addon.exports.result import Result
from irpso_addon.exports.web.page import write_page
from irpso_addon.exports.web.photographs import Photographs
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.maps import Maps
from tests.builders.browser import Browser, chromium
from tests.builders.command_line import smooth_maps
from tests.oracles import reflectance as oracles

NEEDS_CHROMIUM = pytest.mark.skipif(
    chromium() is None, reason="Chromium is not installed; on Debian: apt-get install chromium"
)
SHAPE = (72, 96)
UP = np.array([0.0, 0.0, 1.0])
PLAIN = "controls=0&zoom=1"  # a texel is a pixel


@pytest.fixture(scope="module")
def browser():
    """Chromium, once for a module."""
    browser = Browser()
    yield browser
    browser.close()


def maps_of(name, shape=SHAPE, covered=None, **more):
    """Return smooth maps of a shipped model with scalars in 20 % to 80 % of their ranges; roughness is at least 0.2."""
    model = load_model(name)
    scalars = [p for p in model.parameters if p.components == 1]
    ends = {p.name: np.array([0.2, 0.8]) * p.width + p.range[0] for p in scalars}
    values = smooth_maps(shape, {key: tuple(pair) for key, pair in ends.items()}, seed=3)
    values = {key: np.float32(value).reshape(*shape, -1) for key, value in values.items()}
    return Maps(model, values, np.ones(shape, bool) if covered is None else covered, **more)


def oracle(maps, light, view=UP):
    """Return (H, W, 3) float64 radiance, row 0 at the top."""
    values = {
        key: value[..., 0] if value.shape[-1] == 1 else value
        for key, value in ((key, np.float64(value)) for key, value in maps.values.items())
    }
    return oracles.MODELS[maps.model.name](values, light, view)[::-1]


def opened(browser, folder, maps, photographs=None, state="", name="leaf"):
    """Write a page and open it at the size of the maps; return the folder."""
    write_page(Result(name, maps), folder, photographs)
    browser.resize(*maps.solved.shape[::-1])
    browser.open(folder / "index.html", f"{PLAIN}&{state}")
    return folder


def codes(browser):
    return browser.screenshot() / 255.0


def psnr(a, b):
    return -10 * np.log10(((a - b) ** 2).mean())


def lit(browser, light):
    browser.state(f"{PLAIN}&light={light[0]:.6f},{light[1]:.6f}")
    return codes(browser)


def near_photographs(maps, count=3):
    """Return photographs, by the oracle, of a card under near lamps and a perspective camera."""
    height, width = maps.solved.shape
    place = np.array([[-1.2, 0.9, -3.0], [2.4 / width, 0, 0], [0, -1.8 / height, 0]])
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    points = place[0] + x[..., None] * place[1] + y[..., None] * place[2]
    lamps = np.array([[-1.0, 1.4, -1.6], [1.8, 0.2, -2.0], [0.1, -0.4, -1.0]])[:count]
    intensities = np.array([[2.0, 1.5, 1.0], [1.0, 1.2, 2.0], [3.0, 3.0, 3.0]])[:count]
    pictures = []
    for lamp, intensity in zip(lamps, intensities, strict=True):
        toward = lamp - points
        radiance = oracle(maps, oracles.unit(toward)[::-1], oracles.unit(-points)[::-1])
        pictures.append((radiance * intensity / (toward**2).sum(axis=-1, keepdims=True))[::-1].astype(np.float32))
    lights = np.append(lamps, np.ones((count, 1)), axis=-1)
    return Photographs(
        ("a.jpg", "b.jpg", "c.jpg")[:count], np.arange(count) == 1, lights, intensities, np.array([0.0, 0, 0, 1]),
        place, pictures, [float(np.percentile(picture, 99.5)) for picture in pictures],
    )  # fmt: skip
