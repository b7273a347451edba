"""Recovery of a card of twelve megapixels under 24 lights, from JPEG files to the material, within 16 GiB.

Usage: python -m benchmarks.full_size [--quick] [--again] [--output FOLDER]; two hours without a GPU.

The card is a glossy relief with slopes of 14°, shaded in float64 (benchmarks/peers/models.py), with noise, written as
JPEGs. The command runs in a process of its own, with the memory budget of a machine of 16 GiB.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter, zoom

from benchmarks import report
from benchmarks.peers.models import geometry_of, radiance
from benchmarks.peers.problem import Problem, angles
from benchmarks.subjects import spiral_lights
from irpso_addon.capture.images.exr import write_exr
from irpso_addon.core.encode import srgb_from_linear
from irpso_addon.core.optional import present
from irpso_addon.core.paths import DEFAULT_MODEL
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.read import read_maps

SIZE, SMALL = (4000, 3000), (200, 150)
_LIGHTS = 24
_MEMORY = "device=6.4G,host=6.4G"  # the budget where 16 GiB are free
_EXPOSURE, _NOISE, _QUALITY = 0.8, 0.003, 95
_ROWS = 20  # shaded at once
_EVERY = 2.0  # seconds between samples of the process
_COLOURS = ((0.55, 0.16, 0.07), (0.12, 0.28, 0.45))
_TRUTH = "truth.exr"


def measure(quick: bool) -> dict[str, Any]:
    """Recover the card within the memory of a small machine."""
    return recovered(SMALL if quick else SIZE, _MEMORY)


def recovered(size: tuple[int, int], memory: str) -> dict[str, Any]:
    """Make the card, unless it exists, and recover it with this ``--memory``; "" for all of the machine's."""
    capture = report.CACHE / "full_size" / "{}x{}".format(*size)
    if not (capture / "filenames.txt").is_file():
        make_card(capture, size)
    out = capture.with_name(f"{capture.name}-recovered")
    command = [sys.executable, "-m", "irpso_addon", "recover", str(capture), "-o", str(out)]
    allowed = ["--memory", memory] if memory else []
    plan = subprocess.run(
        [*command, *allowed, "--dry-run"], cwd=report.ROOT, check=True, capture_output=True, text=True
    ).stdout.splitlines()
    run = watched([*command, *allowed, "--checkpoint-every", "60"], out)
    return {"size": size, "lights": _LIGHTS, "memory": memory, "plan": plan, **run, "errors": errors(capture, out)}


def make_card(folder: Path, size: tuple[int, int]) -> None:
    """Write the photographs, their lights, and the true maps (``truth.exr``, row 0 at the bottom)."""
    from PIL import Image

    width, height = size
    folder.mkdir(parents=True, exist_ok=True)
    relief = sum(scale * _noise(size, grain, n) for n, (grain, scale) in enumerate(((160, 22), (24, 1.6), (8, 0.25))))
    up, right = np.gradient(relief)
    normal = np.stack([-right, -up, np.ones_like(up)], axis=-1).astype(np.float32)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    share = 1 / (1 + np.exp(-6 * _noise(size, 90, 3)))[..., None]
    colour = (share * _COLOURS[0] + (1 - share) * _COLOURS[1]) * (1 + 0.12 * _noise(size, 30, 4)[..., None])
    colour = np.clip(colour, 0.02, 0.9).astype(np.float32)
    rough = np.clip(0.28 + 0.3 / (1 + np.exp(-4 * _noise(size, 120, 5))) + 0.03 * _noise(size, 16, 6), 0.12, 0.95)
    lights = spiral_lights(_LIGHTS)
    codes = np.empty((_LIGHTS, height, width, 3), np.uint8)

    def shade(first: int) -> None:
        rows = np.s_[first : first + _ROWS]
        maps = {
            "normal": normal[rows].reshape(-1, 3).astype(float), "base_color": colour[rows].reshape(-1, 3),
            "roughness": rough[rows].reshape(-1, 1).astype(float),
        }  # fmt: skip
        count = len(maps["roughness"])
        maps["specular"] = np.full((count, 1), 0.5)
        problem = Problem(
            np.zeros((_LIGHTS, count, 3)), np.ones((_LIGHTS, count)), lights, np.ones((_LIGHTS, 3)),
            np.array([[0.0, 0.0, 1.0]]), np.zeros((count, 2)), "principled",
        )  # fmt: skip
        diffuse, specular = radiance(np, "principled", maps, geometry_of(problem))
        light = _EXPOSURE * (diffuse[..., None] * maps["base_color"] + specular[..., None])
        noise = np.random.default_rng((7, first)).normal(size=light.shape)
        light = np.clip(light + _NOISE * noise, 0, 1)
        codes[:, rows] = np.rint(255 * srgb_from_linear(light)).reshape(_LIGHTS, -1, width, 3)

    names = [f"photo_{number:02}.jpg" for number in range(_LIGHTS)]

    def save(number: int) -> None:
        Image.fromarray(codes[number, ::-1]).save(folder / names[number], quality=_QUALITY)

    with ThreadPoolExecutor() as pool:
        list(pool.map(shade, range(0, height, _ROWS)))
        list(pool.map(save, range(_LIGHTS)))
    parts = {"normal": normal, "base_color": colour * np.float32(_EXPOSURE), "roughness": rough[..., None]}
    write_exr(folder / _TRUTH, {
        name: {c: np.ascontiguousarray(value[..., i], np.float32) for i, c in enumerate("RGB"[: value.shape[-1]])}
        for name, value in parts.items()
    }, half=True)  # fmt: skip
    np.savetxt(folder / "light_directions.txt", lights)
    (folder / "filenames.txt").write_text("\n".join(names) + "\n", encoding="utf-8")


def _noise(size: tuple[int, int], grain: int, seed: int) -> np.ndarray:
    """Return (H, W) float32 smooth noise of deviation 1."""
    width, height = size
    coarse = np.random.default_rng(seed).normal(size=(height // grain + 6, width // grain + 6)).astype(np.float32)
    noise = zoom(gaussian_filter(coarse, 1), grain, order=3)[:height, :width]
    return noise / noise.std()


def watched(command: list[str], out: Path) -> dict[str, Any]:
    """Run a command; return its seconds, processor seconds ("work"), peak memory, GiB written, and shown progress.

    memory_at_most: GiB, without file pages, which the system can drop. foreseen: (seconds, percent shown).
    """
    began, before = time.perf_counter(), os.times()
    process = subprocess.Popen(command, cwd=report.ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    seen: dict[str, Any] = {"memory_at_most": 0.0, "written": 0.0, "checkpoint": 0.0, "preview": None, "foreseen": []}

    def progress() -> None:
        text = b""
        while piece := present(process.stderr).read(64):
            text = (text + piece)[-400:]
            if b"recover [" in text and b"%" in (last := text.rpartition(b"recover [")[2]):
                words = last.partition(b"]")[2].split()
                if words and words[0].isdigit():
                    seen["foreseen"].append((time.perf_counter() - began, int(words[0])))

    reader = threading.Thread(target=progress, daemon=True)
    reader.start()
    while process.poll() is None:
        update_usage(process.pid, out, seen, time.perf_counter() - began)
        time.sleep(_EVERY)
    reader.join()
    usage = os.times()
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command)
    work = usage.children_user + usage.children_system - before.children_user - before.children_system
    return {**seen, "seconds": time.perf_counter() - began, "work": work}


def update_usage(pid: int, out: Path, seen: dict[str, Any], now: float) -> None:
    """Update ``seen`` from /proc and the output folder of a process; now: seconds since its start."""
    try:
        status = Path(f"/proc/{pid}/status").read_text().split()
        counters = Path(f"/proc/{pid}/io").read_text().split()
    except OSError:  # the process has just ended, or the system is not Linux
        return
    if "RssAnon:" in status:
        seen["memory_at_most"] = max(seen["memory_at_most"], int(status[status.index("RssAnon:") + 1]) / 2**20)
        seen["written"] = int(counters[counters.index("write_bytes:") + 1]) / 2**30
    if (out / "checkpoint.npz").is_file():
        seen["checkpoint"] = max(seen["checkpoint"], (out / "checkpoint.npz").stat().st_size / 2**30)
    if seen["preview"] is None and (out / "preview" / "report.json").is_file():
        seen["preview"] = now


def errors(capture: Path, out: Path) -> dict[str, float]:
    """Return mean errors: of the normal in degrees, of base colour in %, of roughness and metallic."""
    truth = read_maps(capture / _TRUTH, load_model(DEFAULT_MODEL))
    maps = read_maps(out, load_model(DEFAULT_MODEL))
    colour = np.abs(maps["base_color"] - truth["base_color"]) / truth["base_color"]
    return {
        "normal": float(angles(maps["normal"].reshape(-1, 3), truth["normal"].reshape(-1, 3)).mean()),
        "base_color": 100 * float(colour.mean()),
        "roughness": float(np.abs(maps["roughness"] - truth["roughness"]).mean()),
        "metallic": float(maps["metallic"].mean()),
    }


def write(data: dict[str, Any], folder: Path) -> list[str]:
    """Return the page's lines."""
    (width, height), error = data["size"], data["errors"]
    memory = f" --memory {data['memory']}`, what is planned on a machine of 16 GiB" if data["memory"] else "`"
    half = next((seconds for seconds, percent in data["foreseen"] if percent >= 50), None)
    return [
        f"A card of {width} × {height} texels from {data['lights']} JPEGs, `recover{memory}. Memory: without pages of"
        " files. Source: [full_size.py](../../benchmarks/full_size.py).",
        "",
        "```",
        *data["plan"],
        "```",
        "",
        "| from files to material | |",
        "|---|---|",
        f"| clock, processor | {data['seconds'] / 60:.0f} min, {data['work'] / 60:.0f} min |",
        *([f"| preview of a quarter after | {data['preview'] / 60:.1f} min |"] if data["preview"] else []),
        *([f"| 50 % shown after | {100 * half / data['seconds']:.0f} % of the time |"] if half else []),
        f"| memory at most | {data['memory_at_most']:.1f} GiB |",
        f"| written to disk | {data['written']:.0f} GiB |",
        f"| checkpoint at most | {data['checkpoint']:.2f} GiB |",
        f"| normal, base colour, roughness, metallic off by | {error['normal']:.2f}°, {error['base_color']:.1f} %,"
        f" {error['roughness']:.3f}, {error['metallic']:.3f} |",
    ]


def headline(data: dict[str, Any]) -> str:
    """Return the text of the index."""
    return f"12 megapixels, 24 JPEGs: {data['seconds'] / 60:.0f} min, {data['errors']['normal']:.2f}°"


PROGRAM = report.Program(
    "full_size", "Twelve megapixels within 16 GiB", __file__, measure, write, headline,
    report.RECOVER,
)  # fmt: skip

if __name__ == "__main__":
    report.run(PROGRAM)
