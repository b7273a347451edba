"""Takes the pictures of the guide from a real Blender window and puts them into docs/images; `make docs-images`.

What is shown is made in code: a head with painted maps, photographed by the program's own renderer (docs_scene.py).
Blender is the one of BLENDER=/path, else Debian's, as for the tests in a window.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from blender_window import Box, Window, build_package, find_blender, install, open_window

ROOT = Path(__file__).resolve().parent.parent
IMAGES = ROOT / "docs" / "images"
SCENE = ROOT / "scripts" / "docs_scene.py"
RESOLUTION, SMALL = 384, 96  # texels along a side: for the pictures of the maps, of the swarm
LIGHT = 9  # the observation whose light is shown
NOISY, LATE = 14, 45  # iterations at which pictures are taken, between the first guess and the end
SWARM_AT = 120  # iteration of the preset `paper` at which the swarm is pictured
FACTS, REPORT = 222, 502  # pixels: of what Blender itself says of an extension, of the preferences below that
# Where the head is in the viewport, in fractions of it: left, top, right, bottom.
HEAD = (0.335, 0.27, 0.72, 0.79)
SLOW = 900  # seconds: software renderers on busy machines take their time


class Studio:
    """A window with the head in it, and the folder that pictures go to."""

    def __init__(self, window: Window, folder: Path):
        self.window, self.folder = window, folder

    def prepare(self) -> None:
        """Build the scene and its capture, and import that."""
        run, capture = self.window.run, str(self.folder / "head")
        run(SCENE.read_text(encoding="utf-8"))
        run("head = build_scene()\nlook()\nsession, settings = part('ui.session.session'), bpy.context.scene.irpso")
        run(f"write_capture(head, {capture!r})", timeout=SLOW)
        run(f"bpy.ops.wm.save_as_mainfile(filepath={str(self.folder / 'head.blend')!r})")
        self.window.drag(*_edge(self.window.open_sidebar("IRPSO"), 60))
        run(f"bpy.ops.irpso.import_capture(filepath={capture + '/capture.toml'!r})")
        self.window.wait("settings.checked_path == settings.capture_path", SLOW)
        run(f"settings.resolution = {RESOLUTION}")

    def recover(self, **schedule: object) -> None:
        """Press Recover, with settings of the schedule, and rest at the first picture."""
        for name, value in schedule.items():
            self.window.run(f"settings.schedule.{name} = {value!r}")
        self.window.run("bpy.ops.irpso.recover('INVOKE_DEFAULT')")
        self.window.wait("session.current().display is not None", SLOW)
        self.window.run("bpy.ops.irpso.pause()")

    def go_on(self, until: str) -> None:
        """Let the recovery run until an expression of ``session.current()``, as ``s``, is true; rest then."""
        self.window.run("bpy.ops.irpso.resume()")
        self.window.wait(f"(lambda s: s.state == 'done' or ({until}))(session.current())", SLOW)
        self.window.run("bpy.ops.irpso.pause.poll() and bpy.ops.irpso.pause()")

    def probe(self) -> None:
        """Watch the error at four places."""
        self.window.run("[session.current().probes.add(*texel(place)) for place in PROBED]")

    def show(self, **view: object) -> None:
        """Set what is drawn, and let it be drawn to the end."""
        for name, value in view.items():
            self.window.run(f"settings.view.{name} = {value!r}", area="")
        self.window.run("redrawn(50)", area="")

    def take(self, name: str, *boxes: Box) -> list[Path]:
        """Take parts of the screen; return their paths."""
        return [self.window.screenshot(f"{name}-{k}", box) for k, box in enumerate(boxes)]

    def moment(self, name: str) -> Path:
        """Take the head alone with its roughness."""
        self.window.run("probes = list(session.current().probes)\nsession.current().probes.clear()")
        self.show(show_lights=False, show_cameras=False, show_curves=False, parameter="roughness")
        (picture,) = self.take(name, self.head())
        self.window.run("session.current().probes.extend(probes)")
        return picture

    def publish(self, name: str, parts: list[Path], width: int, colors: int) -> None:
        """Put pictures side by side into docs/images, so wide in pixels, with so many colours: a clone stays small."""
        target = self.folder / f"{name}.png"
        arguments = [*map(str, parts), "+append", "-resize", f"{width}x>", "-strip", "-dither", "None"]
        arguments += ["-colors", str(colors), "-define", "png:compression-level=9"]
        arguments += ["-define", "png:compression-filter=0", f"PNG8:{target}"]
        done = self.window.blender.run("convert", *arguments)
        if done.returncode:
            raise SystemExit(f"ImageMagick could not make {name}.png: {done.stdout}")
        IMAGES.mkdir(parents=True, exist_ok=True)
        (IMAGES / target.name).write_bytes(target.read_bytes())

    def head(self) -> Box:
        """Return where the head is on the screen."""
        view = self.window.region()
        left, top, right, bottom = HEAD
        x, y = view.at(left, top)
        return Box(x, y, round((right - left) * view.width), round((bottom - top) * view.height))

    def view(self, *, sidebar: bool = False) -> Box:
        """Return where the 3D viewport is on the screen, below its header, with the sidebar or without."""
        view, side = self.window.region(), self.window.region("VIEW_3D", "UI")
        right = view.x + view.width if sidebar else side.x
        return Box(view.x, side.y, right - view.x, view.y + view.height - side.y)


def panel(studio: Studio) -> None:
    """The sidebar before Recover, as far as it goes down."""
    box = studio.window.region("VIEW_3D", "UI")
    studio.publish("panel", studio.take("panel", box), 320, 64)


def converging(studio: Studio) -> None:
    """Three moments of a recovery, which is done afterwards; and before its end, the window with four probed texels."""
    studio.recover()
    studio.probe()
    parts = [studio.moment("first")]
    studio.go_on(f"s.progress.iteration_in_all >= {NOISY}")
    parts.append(studio.moment("noisy"))
    studio.go_on(f"s.progress.iteration_in_all >= {LATE}")
    studio.show(show_curves=True, show_lights=True, parameter="base_color", observation=LIGHT + 1)
    studio.publish("probes", studio.take("probes", studio.view(sidebar=True)), 900, 128)
    studio.go_on("False")
    parts.append(studio.moment("last"))
    studio.publish("converging", parts, 960, 48)


def error(studio: Studio) -> None:
    """The error on the head, with its legend."""
    studio.window.run("session.current().probes.clear()")
    studio.show(shown="ERROR")
    view, head = studio.view(), studio.head()
    box = Box(head.x, head.y, view.x + view.width - head.x, view.y + view.height - head.y)
    studio.publish("error", studio.take("error", box), 600, 96)


def image_editor(studio: Studio) -> None:
    """A map, flat, in the Image editor in the place of the 3D viewport."""
    run = studio.window.run
    run("area = largest('VIEW_3D')\narea.type = 'IMAGE_EDITOR'", area="")
    studio.window.open_sidebar("IRPSO", "IMAGE_EDITOR")
    studio.show(shown="PARAMETER", parameter="normal", show_curves=False)
    run("bpy.ops.image.view_all(fit_view=True)", area="IMAGE_EDITOR")
    view = studio.window.region("IMAGE_EDITOR")
    studio.publish("image_editor", studio.take("image_editor", view), 860, 96)
    run("area.type = 'VIEW_3D'", area="")


def rendered(studio: Studio) -> None:
    """The kept material as Cycles shows it in the viewport, under one light of the capture."""
    run = studio.window.run
    run(f"bpy.ops.irpso.keep()\nbpy.ops.irpso.standard_view()\nbpy.ops.irpso.create_scene()\nlit_by({LIGHT})")
    studio.show(show=False)
    run("rendered_view()")
    studio.window.run("waiting(20)", area="", timeout=SLOW)
    studio.publish("rendered", studio.take("rendered", studio.head()), 520, 128)
    run("solid_view()")


def swarm(studio: Studio) -> None:
    """The particles of one texel in the space of its colour, under the paper's preset."""
    run = studio.window.run
    run("bpy.ops.irpso.cancel()\nsettings.schedule.preset = 'paper'")
    run(f"settings.resolution = {SMALL}")
    studio.show(show=True, show_curves=True, show_swarm=True, parameter="base_color", show_lights=False)
    studio.recover()
    studio.probe()
    studio.go_on(f"s.progress.iteration_in_all >= {SWARM_AT}")
    studio.show(probe=1)
    studio.publish("swarm", studio.take("swarm", studio.view()), 760, 96)
    run("bpy.ops.irpso.cancel()")


def preferences(studio: Studio) -> None:
    """The add-on's preferences with the report on this machine."""
    run = studio.window.run
    run("bpy.ops.irpso.doctor()", timeout=SLOW)
    run("area = largest('VIEW_3D')\narea.type = 'PREFERENCES'\nshow_preferences()", area="")
    studio.window.run("redrawn(20)", area="")
    # Above are the extension's facts with the folder of this very Blender, below is nothing.
    view = studio.window.region("PREFERENCES")
    box = Box(view.x, view.y + FACTS, view.width, REPORT)
    studio.publish("preferences", studio.take("preferences", box), 780, 24)
    run("area.type = 'VIEW_3D'", area="")


# In this order: each goes on from where the one before has ended.
STAGES = (panel, converging, error, image_editor, rendered, swarm, preferences)


def _edge(box: Box, wider: int) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return from where to where to drag a sidebar's left edge."""
    x, y = box.x, box.y + box.height // 2
    return (x, y), (x - wider, y)


def main() -> None:
    """Take all pictures."""
    blender = find_blender()
    with tempfile.TemporaryDirectory(prefix="irpso-pictures-") as scratch:
        folder = Path(scratch)
        install(blender, build_package(folder / "dist"), folder / "user")
        with open_window(blender, folder / "user", folder / "pictures") as window:
            # Of Blender 4.3 itself: in a window, every evaluated mesh with all of its layers leaves five blocks behind.
            window.expect("Not freed memory blocks")
            studio = Studio(window, folder)
            studio.prepare()
            for stage in STAGES:
                stage(studio)


if __name__ == "__main__":
    main()
