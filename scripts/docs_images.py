"""Makes the pictures of the guide into docs/images; `make docs-images`.

Usage: python scripts/docs_images.py [stills] [panels] [views]    all three, unless some are named
stills: of the sample capture and its recovery, by the program's commands (docs_stills.py). panels: of the panels and
preferences, and the record that a test compares (panel_words.py). views: of the viewport while the sample is recovered.
Panels and views come from a real Blender window: that of BLENDER=/path, else Debian's, as for the tests in a window.
What the pictures are made from is kept in .cache/docs-images: remove that folder to begin anew.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from pathlib import Path

import panel_words
from blender_window import Box, Window, build_package, find_blender, install, open_window
from docs_stills import IMAGES, QUALITY, ROOT, beside, make_stills, narrowed, prepare
from PIL import Image

WORK = ROOT / ".cache" / "docs-images"
SCENE = ROOT / "scripts" / "docs_scene.py"
LIGHT = 4  # the observation whose light is shown, from 1
QUICK = 0.25  # scale of the card for pictures of panels
EARLY, LATE = 14, 45  # iterations at which pictures are taken, of the panels and of the maps
SWARM_AT = 120  # iteration of the preset `paper` at which the swarm is pictured
FACTS, REPORT = 222, 502  # heights in pixels: of Blender's facts about an extension, and of the preferences below
SLOW = 900  # seconds: software renderers on busy machines take their time
GROUPS = ("stills", "panels", "views")


class Studio:
    """A window with the sample. folder: of its files."""

    def __init__(self, window: Window, folder: Path):
        self.window, self.folder = window, folder

    def prepare(self) -> None:
        """Open a copy of the sample."""
        run, copy = self.window.run, self.folder / "sample"
        shutil.copytree(WORK / "sample", copy)
        run(SCENE.read_text(encoding="utf-8"))
        run("empty()\nsession, settings = part('ui.session.session'), bpy.context.scene.irpso")
        run(f"bpy.ops.wm.save_as_mainfile(filepath={str(self.folder / 'tile.blend')!r})")
        self.window.drag(*_edge(self.window.open_sidebar("IRPSO"), 60))
        run(f"bpy.ops.irpso.open_sample(folder={str(copy)!r})", timeout=SLOW)
        self.window.wait("settings.card_distance > 0 and settings.checked_path == settings.capture_path", SLOW)

    def recover(self, **schedule: object) -> None:
        """Press Recover, with settings of the schedule, and pause at the first picture."""
        for name, value in schedule.items():
            self.window.run(f"settings.schedule.{name} = {value!r}")
        self.window.run("bpy.ops.irpso.recover('INVOKE_DEFAULT')")
        self.window.wait("session.current().display is not None", SLOW)
        self.window.run("bpy.ops.irpso.pause()")

    def go_on(self, until: str) -> None:
        """Run the recovery until an expression of ``s``, the current session, is true; then pause."""
        self.window.run("bpy.ops.irpso.resume()")
        self.window.wait(f"(lambda s: s.state == 'done' or ({until}))(session.current())", SLOW)
        self.window.run("bpy.ops.irpso.pause.poll() and bpy.ops.irpso.pause()")

    def probe(self) -> None:
        """Probe the error at four texels."""
        self.window.run("[session.current().probes.add(*texel(place)) for place in PROBED]")

    def show(self, **view: object) -> None:
        """Set properties of the view, and wait until it is drawn."""
        for name, value in view.items():
            self.window.run(f"settings.view.{name} = {value!r}", area="")
        self.window.run("redrawn(50)", area="")

    def take(self, box: Box) -> Image.Image:
        """Return a picture of a part of the screen."""
        return Image.open(self.window.screenshot("part", box)).convert("RGB")

    def card(self) -> Box:
        """Return the card's rectangle on the screen."""
        return Box(*self.window.run("card_box()"))

    def view(self) -> Box:
        """Return the rectangle of the 3D viewport below its headers."""
        view, headers = self.window.region(), self.window.region("VIEW_3D", "TOOL_HEADER")
        top = headers.y + headers.height
        return Box(view.x, top, view.width, view.y + view.height - top)

    def sidebar(self) -> Image.Image:
        """Return a picture of the sidebar."""
        self.window.run("redrawn(20)", area="")
        return self.take(self.window.region("VIEW_3D", "UI"))


def publish(name: str, picture: Image.Image, width: int, colours: int = 0) -> None:
    """Write a picture into docs/images, at most ``width`` wide: as PNG of ``colours`` colours, or as JPEG if 0."""
    picture = narrowed(picture, width) if picture.width > width else picture
    if colours:
        picture.quantize(colours, dither=Image.Dither.NONE).save(IMAGES / f"{name}.png", optimize=True)
    else:
        picture.save(IMAGES / f"{name}.jpg", quality=QUALITY, optimize=True, progressive=True)


def panels(studio: Studio) -> None:
    """Publish the sidebar before Recover, during a paused recovery, and after it; then the preferences."""
    parts = [studio.sidebar()]
    studio.window.run(f"settings.picture_scale = {QUICK}")
    studio.recover()
    studio.go_on(f"s.progress.iteration_in_all >= {EARLY}")
    parts.append(studio.sidebar())
    studio.go_on("False")
    parts.append(studio.sidebar())
    studio.window.run("bpy.ops.irpso.cancel()\nsettings.picture_scale = 1")
    publish("panel", beside(parts, 12), 960, 48)
    preferences(studio)
    panel_words.remember()


def preferences(studio: Studio) -> None:
    """Publish the add-on's preferences with the report on this machine."""
    run = studio.window.run
    run("bpy.ops.irpso.doctor()", timeout=SLOW)
    run("area = largest('VIEW_3D')\narea.type = 'PREFERENCES'\nshow_preferences()", area="")
    studio.window.run("redrawn(20)", area="")
    # Crop Blender's facts above, with this machine's folder, and the empty space below.
    view = studio.window.region("PREFERENCES")
    publish("preferences", studio.take(Box(view.x, view.y + FACTS, view.width, REPORT)), 780, 24)
    run("area.type = 'VIEW_3D'", area="")


def views(studio: Studio) -> None:
    """Publish the pictures of the viewport without its bars; each stage continues from the previous one."""
    studio.window.run("bare()")
    for stage in (converging, error, image_editor, rendered, swarm):
        stage(studio)


def converging(studio: Studio) -> None:
    """Publish three moments of a recovery, run to its end, and four probed texels."""
    studio.show(show_lights=False, show_cameras=False, show_curves=False, parameter="base_color")
    studio.recover()
    studio.window.run("closer()")
    parts = [moment(studio)]
    studio.probe()
    studio.go_on(f"s.progress.iteration_in_all >= {LATE}")
    studio.show(show_curves=True)
    publish("probes", studio.take(studio.view()), 760)
    studio.window.run("session.current().probes.clear()")
    parts.append(moment(studio))
    studio.go_on("False")
    parts.append(moment(studio))
    publish("converging", beside([narrowed(part, 250) for part in parts], 5), 760)


def moment(studio: Studio) -> Image.Image:
    """Return a picture of the card alone."""
    studio.show(show_curves=False)
    return studio.take(studio.card())


def error(studio: Studio) -> None:
    """Publish the error on the card, with its legend."""
    studio.show(shown="ERROR")
    view, card = studio.view(), studio.card()
    publish("error", studio.take(Box(card.x, view.y, view.x + view.width - card.x, view.height)), 520)


def image_editor(studio: Studio) -> None:
    """Publish a map in the Image editor, in place of the 3D viewport."""
    run = studio.window.run
    run("area = largest('VIEW_3D')\narea.type = 'IMAGE_EDITOR'", area="")
    studio.show(shown="PARAMETER", parameter="normal", show_curves=False)
    run("bpy.ops.image.view_all(fit_view=True)", area="IMAGE_EDITOR")
    publish("image_editor", studio.take(studio.window.region("IMAGE_EDITOR")), 640)
    run("area.type = 'VIEW_3D'", area="")


def rendered(studio: Studio) -> None:
    """Publish the kept material, rendered by Cycles in the viewport under one light of the capture."""
    run = studio.window.run
    run(f"bpy.ops.irpso.keep()\nbpy.ops.irpso.standard_view()\nbpy.ops.irpso.create_scene()\nlit_by({LIGHT})")
    run("aslant(next(o for o in bpy.context.scene.objects if o.type == 'MESH'))")
    studio.show(show=False)
    run("rendered_view()")
    studio.window.run("waiting(40)", area="", timeout=SLOW)
    view = studio.view()
    publish("rendered", studio.take(Box(view.x + view.width // 6, view.y, view.width * 2 // 3, view.height)), 560)
    run("solid_view()\nbpy.ops.irpso.cancel()\nempty()")


def swarm(studio: Studio) -> None:
    """Publish the particles of a probed texel during the search."""
    run = studio.window.run
    run(f"settings.picture_scale = {QUICK}\nsettings.schedule.preset = 'paper'")
    studio.show(show=True, show_curves=True, show_swarm=True, parameter="base_color", show_lights=False)
    studio.recover()
    studio.window.run("closer()")
    studio.probe()
    studio.go_on(f"s.progress.iteration_in_all >= {SWARM_AT}")
    studio.show(probe=1)
    publish("swarm", studio.take(studio.view()), 620)
    run("bpy.ops.irpso.cancel()")


def _edge(box: Box, wider: int) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return start and end of a drag that makes a sidebar ``wider`` pixels wider."""
    x, y = box.x, box.y + box.height // 2
    return (x, y), (x - wider, y)


def main() -> None:
    """Make the pictures of the command line's groups."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("groups", nargs="*", metavar="GROUP", help=f"of {', '.join(GROUPS)}; default all")
    groups = parser.parse_args().groups or GROUPS
    if unknown := sorted(set(groups) - set(GROUPS)):
        parser.error(f"there is no group {unknown[0]}; choose of {', '.join(GROUPS)}")
    WORK.mkdir(parents=True, exist_ok=True)
    if "stills" in groups:
        make_stills(WORK)
    prepare(WORK)
    in_window = [stage for stage in (panels, views) if stage.__name__ in groups]
    if not in_window:
        return
    blender = find_blender()
    with tempfile.TemporaryDirectory(prefix="irpso-pictures-") as scratch:
        folder = Path(scratch)
        install(blender, build_package(folder / "dist"), folder / "user")
        with open_window(blender, folder / "user", folder / "pictures") as window:
            # A leak of Blender 4.3: in a window, every evaluated mesh with all of its layers leaks five blocks.
            window.expect("Not freed memory blocks")
            studio = Studio(window, folder)
            studio.prepare()
            for stage in in_window:
                stage(studio)


if __name__ == "__main__":
    main()
