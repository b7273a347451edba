"""Responsiveness of a recovery in a real Blender window: first picture, longest stall, cost of the pictures.

Usage: python -m benchmarks.window [--quick] [--again] [--output FOLDER]

Needs what `make test-gui` needs. The window is that of Debian's Blender under Xvfb (BLENDER_SUITE, BLENDER_BACKEND), or
of the one that BLENDER names. A stall is the time between two turns of Blender's main loop, by a timer that every turn
calls; it includes Blender's own drawing.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import report, subjects
from irpso_addon.capture.camera import Camera
from irpso_addon.capture.types import Capture, Light, Observation
from irpso_addon.capture.write import write_capture

sys.path.insert(0, str(report.ROOT / "scripts"))

LARGE, LIGHTS = 512, 32  # size at which a window must not stall
SMALL, ITERATIONS, REPEATS = 96, 1000, 3  # of the preset swarm, with pictures and without
MODULE = "bl_ext.user_default.irpso.irpso_addon.ui"
WATCH = f"""
import importlib, time
session = importlib.import_module("{MODULE}.session.session")
handlers = importlib.import_module("{MODULE}.overlay.handlers")
seen = {{"pressed": 0.0, "last": 0.0, "first": None, "stalls": [], "draws": 0}}

def drawn():
    seen["draws"] += 1
    if seen["first"] is None and handlers._overlay is not None and handlers._overlay._pictures:
        seen["first"] = time.perf_counter() - seen["pressed"]

def beat():
    now, running = time.perf_counter(), session.current()
    if running is not None and running.active:
        seen["stalls"].append((now - seen["last"], running.title))
    seen["last"] = now
    return 0.0

bpy.types.SpaceView3D.draw_handler_add(drawn, (), "WINDOW", "POST_PIXEL")
bpy.app.timers.register(beat, persistent=True)
"""
PRESS = """
seen.update(pressed=time.perf_counter(), last=time.perf_counter(), first=None, stalls=[], draws=0)
bpy.ops.irpso.recover("INVOKE_DEFAULT")
"""
REDRAW = """
def redraws():
    gaps, last = [], time.perf_counter()
    for _ in range(30):
        largest("VIEW_3D").tag_redraw()
        yield
        gaps.append(time.perf_counter() - last)
        last += gaps[-1]
    return gaps
redraws()
"""
ENDED = "session.current().state == 'done'"


def measure(quick: bool) -> dict[str, Any]:
    """Return the measurements of a large card, with new and with cached shaders, and of many iterations."""
    from blender_window import build_package, find_blender, install, open_window

    blender, backend = find_blender(), os.environ.get("BLENDER_BACKEND") or "opengl"
    with tempfile.TemporaryDirectory(prefix="irpso-bench-") as scratch:
        folder = Path(scratch)
        install(blender, build_package(folder / "dist"), folder / "user")
        large = write_card(folder / "large", 48 if quick else LARGE, 8 if quick else LIGHTS)
        small = write_card(folder / "small", 24 if quick else SMALL, 8 if quick else LIGHTS)

        @contextmanager
        def window(shaders: str) -> Iterator[Any]:
            os.environ["MESA_SHADER_CACHE_DIR"] = str(folder / shaders)
            with open_window(blender, folder / "user", folder / "pictures", backend) as opened:
                opened.open_sidebar("IRPSO")
                opened.run(WATCH)
                yield opened

        result: dict[str, Any] = {"blender": blender.name, "backend": backend, "runs": []}
        for shaders in ("shaders new to the driver", "shaders known to it"):
            report.say(shaders)
            with window("large") as opened:
                result["runs"].append({"title": shaders, **watched(opened, large)})
        with window("small") as opened:
            result["iterations"] = 30 if quick else ITERATIONS
            result["seconds"] = displayed(opened, small, result["iterations"], 1 if quick else REPEATS)
    return result


def write_card(folder: Path, size: int, lights: int) -> Path:
    """Write a noisy card as a capture; return its folder."""
    card = subjects.make_card(size, lights, subjects.NOISY, model="principled")
    observations = tuple(
        Observation(f"light {k}", lambda image=image: image, Light(tuple(map(float, light[:3]))))
        for k, (image, light) in enumerate(zip(card.domain.stack.layers(), card.domain.lights, strict=True))
    )
    camera = Camera.orthographic(size, size, 2.0)
    write_capture(Capture("card", observations, (camera,), (np.ones((size, size), bool),)), folder)
    return folder


def watched(window: Any, capture: Path) -> dict[str, Any]:
    """Recover a capture whose images are already read; return the measurements."""
    redraw = float(np.median(window.run(REDRAW, area="", timeout=300)))
    begin(window, capture)
    window.wait("session.current().recovery is not None", 300)
    window.run("bpy.ops.irpso.cancel()\nsession._previous_run.prepared = None")
    window.run(PRESS, timeout=300)
    anew = window.wait("seen['first']", 300)
    window.run("bpy.ops.irpso.cancel()")
    window.run(PRESS, timeout=300)
    window.wait(ENDED, 3600)
    measured = window.run("[seen['first'], time.perf_counter() - seen['pressed'], seen['draws'], seen['stalls'],"
                      " session.current().longest_stall_s]")  # fmt: skip
    first, seconds, draws, stalls, tick = measured
    lengths = np.array([length for length, _ in stalls])
    worst = sorted(stalls, reverse=True)[:8]
    return {
        "first_picture_s": first, "first_picture_anew_s": anew, "redraw_s": redraw, "seconds": seconds,
        "pictures_per_s": draws / seconds, "slice_s": tick,
        "stalls_s": {f"{q:g} %": float(np.percentile(lengths, q)) for q in (50, 95, 99)},
        "over_100_ms": int((lengths > 0.1).sum()), "turns": len(lengths), "longest": worst,
    }  # fmt: skip


def displayed(window: Any, capture: Path, iterations: int, repeats: int) -> dict[str, list[float]]:
    """Return the seconds of ``iterations`` iterations of the preset swarm with and without shown maps, in turns."""
    begin(window, capture)  # and compile everything
    window.wait(ENDED, 1200)
    window.run(
        "bpy.ops.irpso.cancel()\nbpy.ops.irpso.preset_choose(name='swarm')\n"
        f"bpy.context.scene.irpso.schedule.iterations = {iterations}"
    )
    seconds: dict[str, list[float]] = {"shown": [], "not shown": []}
    for _ in range(repeats):
        for name, shown in (("shown", True), ("not shown", False)):
            window.run(f"bpy.context.scene.irpso.view.show = {shown}")
            window.run(PRESS, timeout=300)
            window.wait(ENDED, 3600)
            seconds[name].append(window.run("time.perf_counter() - seen['pressed']"))
            window.run("bpy.ops.irpso.cancel()")
    return seconds


def begin(window: Any, capture: Path) -> None:
    """Import a capture and press Recover."""
    window.run(f"bpy.ops.irpso.import_capture(filepath={str(capture)!r})")
    window.wait(f"not importlib.import_module('{MODULE}.operators.capture_import').checking(bpy.context.scene)", 600)
    window.run("bpy.context.scene.irpso.subject = 'CARD'")
    window.run(PRESS, timeout=300)


def write(data: dict[str, Any], folder: Path) -> list[str]:
    """Return the page's lines."""
    names = [run["title"] for run in data["runs"]]
    rows = [
        ["first picture after Recover, s", *(report.short(run["first_picture_s"]) for run in data["runs"])],
        [
            "the same, the first guess not known, s",
            *(report.short(run["first_picture_anew_s"]) for run in data["runs"]),
        ],
        ["whole run, s", *(report.short(run["seconds"]) for run in data["runs"])],
        ["pictures a second", *(report.short(run["pictures_per_s"]) for run in data["runs"])],
        ["Blender drawing its window without us, ms", *(report.short(1000 * run["redraw_s"]) for run in data["runs"])],
        ["longest slice of our own, ms", *(report.short(1000 * run["slice_s"]) for run in data["runs"])],
        *(
            [f"turn of the main loop, {q}, ms", *(report.short(1000 * run["stalls_s"][q]) for run in data["runs"])]
            for q in data["runs"][0]["stalls_s"]
        ),
        ["turns over 100 ms, of all", *(f"{run['over_100_ms']} of {run['turns']}" for run in data["runs"])],
    ]
    lines = [
        f"Debian {data['blender']}'s Blender, {data['backend']}, a window of 1600 × 1000 under Xvfb. Preset"
        f" standard, model principled, {LARGE}² texels under {LIGHTS} lights, images already read. The first result"
        " of a run is a least-squares guess; it is cached if the same images were recovered before with the same"
        " model and fitness.",
        "",
        *report.table(["", *names], rows),
        "",
        "The longest turns:",
        "",
    ]
    for run in data["runs"]:
        worst = ", ".join(f"{1000 * length:.0f} ms ({title})" for length, title in run["longest"])
        lines.append(f"- {run['title']}: {worst}")
    shown, hidden = (np.array(data["seconds"][name]) for name in ("shown", "not shown"))
    lines += [
        "",
        f"{data['iterations']} iterations of every stage of the preset swarm, {SMALL}² texels under {LIGHTS}"
        f" lights, {len(shown)} times each in turns: {np.median(shown):.1f} s with the maps shown,"
        f" {np.median(hidden):.1f} s without, a factor of {np.median(shown / hidden):.2f}.",
    ]
    return lines


def headline(data: dict[str, Any]) -> str:
    """Return the page's result in a line."""
    run = data["runs"][-1]
    return f"first picture after {run['first_picture_s']:.2f} s, longest turn {1000 * run['longest'][0][0]:.0f} ms"


PROGRAM = report.Program(
    "window",
    "In Blender's window",
    __file__,
    measure,
    write,
    headline,
    (*report.RECOVER, "irpso_addon/ui"),  # fmt: skip
)

if __name__ == "__main__":
    report.run(PROGRAM)
