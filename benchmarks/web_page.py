"""The web page's pixels against Cycles and against the program's render of the same maps, under ten lights.

Usage: python -m benchmarks.web_page RESULT

RESULT is a card's folder that ``irpso recover`` wrote. Chromium draws a texel as a pixel; Cycles renders material.blend
with every sample at the middle of its pixel, without shadows and bounces, as the page does.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.relit_in_cycles import by_cycles
from benchmarks.scenes.scores import psnr
from irpso_addon.core.encode import srgb_from_linear
from irpso_addon.exports.ptm import card_renderer, even_lights
from irpso_addon.exports.result import read_result
from irpso_addon.exports.web.page import write_page
from irpso_addon.results.maps import Maps
from tests.builders.browser import Browser

_LIGHTS, _WIDEST = 10, 65.0  # degrees from the normal
_SAMPLES, _NARROW = 4, 0.01  # of Cycles; pixels, the filter's width


def by_program(maps: Maps, lights: np.ndarray) -> np.ndarray:
    """Return (K, H, W, 3) radiance of maps by the solver's shader."""
    renderer = card_renderer(maps, lights)
    pictures = np.stack([renderer.render(k)[..., :3] for k in range(len(lights))])
    renderer.close()
    return pictures


def by_page(folder: Path, size: tuple[int, int], lights: np.ndarray) -> np.ndarray:
    """Return (K, H, W, 3) sRGB values that the page shows in Chromium."""
    browser, pictures = Browser(*size), []
    browser.open(folder / "index.html", "controls=0&zoom=1")
    for u, v, _ in lights:
        browser.state(f"controls=0&zoom=1&light={u:.6f},{v:.6f}")
        pictures.append(browser.screenshot()[::-1] / 255)
    browser.close()
    return np.stack(pictures)


def main() -> None:
    """Print mean and least PSNR, in dB, of sRGB values over the covered texels."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("result", type=Path)
    result = read_result(parser.parse_args().result)
    covered, lights = result.maps.solved, even_lights(_LIGHTS, _WIDEST)
    size = covered.shape[::-1]
    shown = [
        srgb_from_linear(np.clip(made, 0, 1))
        for made in (by_cycles(result.blend, size, lights, _SAMPLES, _NARROW), by_program(result.maps, lights))
    ]
    with TemporaryDirectory() as folder:
        write_page(result, folder)
        page = by_page(Path(folder), size, lights)
    for name, one, other in (
        ("page against Cycles", page, shown[0]),
        ("page against the program", page, shown[1]),
        ("program against Cycles", shown[1], shown[0]),
    ):
        psnrs = [psnr(a, b, covered) for a, b in zip(one, other, strict=True)]
        print(f"{name}: mean {np.mean(psnrs):.1f} dB, least {np.min(psnrs):.1f} dB")


if __name__ == "__main__":
    main()
