"""Cases of bad input for the public command: name → (function from a folder to arguments, pattern of the message)."""

import re
from pathlib import Path

import numpy as np

from irpso_addon.capture.images.exr import write_exr
from tests.builders import command_line as cli_maker
from tests.builders.command_line import MODELS

SHAPE = (6, 8)
OUT = "out"
LIGHTS = cli_maker.dome_lights(6)
WARD_TOML = (MODELS / "ward.toml").read_text(encoding="utf-8")
WARD_GLSL = (MODELS / "ward.glsl").read_text(encoding="utf-8")
PRESET = (Path(__file__).resolve().parents[2] / "presets" / "swarm.toml").read_text(encoding="utf-8")


def edit(path, old, new):
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")


def recover(*rest, capture="card"):
    """Return a case that needs no files of its own: the arguments of ``recover``."""
    return lambda folder: ["recover", folder / capture, "--iterations", 2, "--quiet", "-o", folder / OUT, *rest]


def broken(capture, breaks):
    def prepare(folder):
        breaks(folder / capture)
        return recover(capture=capture)(folder)

    return prepare


def mesh(name, file="scene.blend"):
    return lambda folder: recover("--blend", folder / file, "--object", name, "--resolution", 8)(folder)


def model(toml=WARD_TOML, glsl=WARD_GLSL, old="", new=""):
    """Return a case with a faulty model of the user."""

    def prepare(folder):
        assert old in toml + glsl
        (folder / "mine.toml").write_text(toml.replace(old, new, 1), encoding="utf-8")
        if glsl:
            (folder / "mine.glsl").write_text(glsl.replace(old, new, 1), encoding="utf-8")
        return recover("--model", folder / "mine.toml")(folder)

    return prepare


def preset(old, new):
    def prepare(folder):
        assert old in PRESET
        (folder / "mine.toml").write_text(PRESET.replace(old, new, 1), encoding="utf-8")
        return recover("--preset", folder / "mine.toml")(folder)

    return prepare


def with_file(name, content, *rest):
    """Return a case with another file in the folder; options that name a file there become its path."""

    def prepare(folder):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return recover(*(folder / r if isinstance(r, str) and (folder / r).exists() else r for r in rest))(folder)

    return prepare


def render(*rest, maps="maps", blend="scene.blend"):
    """Return a case of ``render`` with these options, on 4 × 4 texels of default values."""

    def prepare(folder):
        everything = {"normal": {c: np.full((4, 4), v, np.float32) for c, v in zip("RGB", (0, 0, 1), strict=True)}}
        (folder / "maps").mkdir(exist_ok=True)
        write_exr(folder / "maps" / "maps.exr", everything | {"other": {"Y": np.zeros((4, 4), np.float32)}})
        options = ["--blend", folder / blend, "--object", "square", "--size", "8", "--dome", "1x3", "--quiet"]
        return ["render", folder / maps, "-o", folder / OUT, *options, *rest]

    return prepare


def prepared(make, argv):
    def prepare(folder):
        make(folder)
        return argv(folder)

    return prepare


def directions(text):
    def make(folder):
        (folder / "lights.txt").write_text(text)

    return prepared(make, lambda folder: render("--lights", folder / "lights.txt")(folder))


def damaged_checkpoint(folder):
    (folder / OUT).mkdir()
    (folder / OUT / "checkpoint.npz").write_bytes(b"PK\3\4 this is none")


def fill_out(folder):
    (folder / OUT).mkdir()
    (folder / OUT / "mine.txt").write_text("of the user")


def photographs_in_out(folder):
    """Move the photographs of the capture into the output folder."""
    (folder / OUT).mkdir()
    for path in sorted((folder / "card").glob("*.exr")):
        path.rename(folder / OUT / path.name)
        edit(folder / "card" / "capture.toml", f'"{path.name}"', f'"../{OUT}/{path.name}"')


def picture_in_out(folder):
    (folder / OUT).mkdir()
    (folder / OUT / "normal.png").write_bytes(b"of the user")


def nothing_to_see(card):
    for path in card.glob("*.exr"):
        black = np.full(SHAPE, np.nan, np.float32)
        write_exr(path, {"": {c: black for c in "RGB"}})


def too_few(card):
    text = (card / "capture.toml").read_text(encoding="utf-8")
    (card / "capture.toml").write_text("[[observation]]".join(text.split("[[observation]]")[:3]), encoding="utf-8")


def second_camera(card):
    text = (card / "capture.toml").read_text(encoding="utf-8")
    camera = re.search(r"\[\[camera\]\].*?(?=\n\n)", text, re.S)[0]
    text = text.replace(camera, camera + "\n\n" + camera.replace("camera 1", "camera 2"), 1)
    (card / "capture.toml").write_text(text, encoding="utf-8")


CAPTURES = {
    "no capture there": (recover(capture="nowhere"), r"nowhere: is not there"),
    "a file that is no capture": (
        prepared(lambda f: (f / "note.md").touch(), recover(capture="note.md")), r"note.md: is no capture"),
    "a scene with several meshes": (recover(capture="scene.blend"), r"has \d+ mesh objects; choose one with --object"),
    "words of an asset without one": (recover("--license", "CC0"), r"--license: is of an asset; give its library"),
    "an empty folder": (prepared(lambda f: (f / "void").mkdir(), recover(capture="void")),
        r"void: holds no capture; .* irpso calibrate"),
    "a missing image": (broken("lists", lambda c: (c / "2.exr").unlink()), r"2.exr: this image is not there"),
    "a cut image": (
        broken("lists", lambda c: (c / "2.exr").write_bytes((c / "2.exr").read_bytes()[:200])), r"2.exr: .*cut"),
    "text for an image": (broken("lists", lambda c: (c / "2.exr").write_text("hello")), r"2.exr: is no PNG"),
    "an image of another size": (
        broken("lists", lambda c: write_exr(c / "1.exr", {"": {"Y": np.ones((6, 9), np.float32)}})), r"1.exr.*9.6"),
    "a light too few": (broken("lists", lambda c: np.savetxt(c / "light_directions.txt", LIGHTS[:5])), r"5 lights"),
    "a light that is no number": (
        broken("lists", lambda c: edit(c / "light_directions.txt", "0.", "nan 0.")), r"directions.txt: line 1"),
    "a light of zero length": (
        broken("lists", lambda c: np.savetxt(c / "light_directions.txt", LIGHTS * 0)), r"directions.txt: line 1.*zero"),
    "a negative intensity": (
        broken("lists", lambda c: (c / "light_intensities.txt").write_text("-1\n" * 6)), r"intensities.txt: line 1"),
    "a mask that covers nothing": (
        broken("lists", lambda c: write_exr(c / "mask.exr", {"": {"Y": np.zeros(SHAPE, np.float32)}})), r"mask.exr"),
    "a camera of no known kind": (
        broken("lists", lambda c: (c / "camera.toml").write_text("fov = 3")), r"camera.toml: unknown key 'fov'"),
    "a table that is no TOML": (
        broken("card", lambda c: edit(c / "capture.toml", "[[camera]]", "[[c")), r"not valid TOML"),
    "an unknown camera": (
        broken("card", lambda c: edit(c / "capture.toml", 'camera = "camera 1"', 'camera = "up"')), r"toml.*'up'"),
    "two lights": (broken("card", too_few), r"has 2 lights; a normal needs at least three"),
    "photographs in the output folder": (prepared(photographs_in_out, recover()), r"out: holds the photographs"),
    "a picture that a map would replace": (
        prepared(picture_in_out, recover()), r"normal.png: would be replaced, but no recovery wrote it"),
    "a picture that a map of the paper's experiment would replace": (
        prepared(picture_in_out, lambda f: ["demo", "--quick", "--quiet", "-o", f / OUT]),
        r"normal.png: would be replaced, but no recovery wrote it"),
    "one photograph to calibrate": (
        lambda f: ["calibrate", f / "card" / "000.exr", "-o", f / OUT, "--quiet"], r"000.exr: is one photograph; give"),
    "lamps inside of the ball": (
        lambda f: ["calibrate", f / "card", "-o", f / OUT, "--fov", 40, "--radius", 32, "--lamp-distance", 9,
                   "--quiet"],
        r"--lamp-distance 9: puts the lamps into the ball, whose --radius is 32"),
    "two cameras and no mesh": (broken("card", second_camera), r"2 cameras"),
    "images without a number in them": (broken("card", nothing_to_see), r"no image of capture"),
}  # fmt: skip

MESHES = {
    "no such .blend": (mesh("square", "none.blend"), r"none.blend.*--blend"),
    "a .blend that is none": (
        prepared(lambda f: (f / "none.blend").write_text("no blend file"), mesh("square", "none.blend")),
        r"cannot open .*none.blend"),
    "no such object": (mesh("cube"), r"no object 'cube'.*'square'"),
    "a camera for a mesh": (mesh("camera"), r"'camera' is of type CAMERA, not a mesh"),
    "a file without a mesh": (mesh("square", "empty.blend"), r"no mesh objects"),
    "many meshes and none named": (
        lambda f: recover("--blend", f / "scene.blend")(f), r"11 mesh objects.*--object.*'square'"),
    "no UV map": (mesh("no uv"), r"'no uv' has no UV map; unwrap"),
    "UVs that overlap": (mesh("twice"), r"UV map 'UVMap' of 'twice' overlaps itself over 100 %"),
    "UVs outside the square": (mesh("outside"), r"'outside': 2 of 2 triangles do not lie in one UDIM tile"),
    "UVs without area": (mesh("collapsed"), r"'collapsed' gives no area"),
    "no faces": (mesh("points"), r"'points' has no faces"),
    "faces without area": (mesh("line"), r"'line' have no area"),
    "vertices that are not numbers": (mesh("not numbers"), r"'not numbers' has vertices that are not numbers"),
    "a scale of zero": (mesh("flat"), r"'flat' has a scale of zero"),
    "a hidden mesh": (mesh("hidden"), r"'hidden' .*hidden; show it"),
    "a mesh that no camera sees": (mesh("far"), r"no image .* shows mesh 'far'"),
    "a linked mesh": (mesh("square", "linked.blend"), r"'square' is linked from .*library.blend; make it local"),
}  # fmt: skip

OPTIONS = {
    "no command": (lambda f: [], r"COMMAND"),
    "an unknown command": (lambda f: ["solve"], r"'solve'"),
    "no output": (lambda f: ["recover", f / "card"], r"-o/--output"),
    "an unknown option": (recover("--fast"), r"--fast"),
    "iterations of text": (recover("--iterations", "many"), r"--iterations.*'many'"),
    "no iterations": (recover("--preset", "swarm", "--iterations", 0), r"no stage has iterations.*refinement"),
    "a seed past 32 bits": (recover("--seed", 2**31), r"--seed.*2147483648"),
    "an unknown model": (recover("--model", "skin"), r"model 'skin'.*principled"),
    "no such model file": (recover("--model", "skin.toml"), r"skin.toml: cannot be read"),
    "an unknown preset": (recover("--preset", "best"), r"preset 'best'.*swarm"),
    "an unknown setting": (recover("--set", "speed=3"), r"no setting 'speed'"),
    "a former setting": (recover("--set", "prior_turn=false"), r"'prior_turn'; it is 'prior_normals' now"),
    "a former value": (recover("--set", "loss=robust"), r"loss must be one of .* 'robust'; it is 'cauchy' now"),
    "a setting without a value": (recover("--set", "particles"), r"--set particles: write NAME=VALUE"),
    "a setting of the wrong type": (recover("--set", "particles=many"), r"particles must be a whole number"),
    "a setting out of range": (recover("--set", "start_fraction=1.5"), r"start_fraction must be at most 1"),
    "a crop that begins with a minus": (
        recover("--crop", "-2,0,4,4"), r"--crop: expected one argument; write --crop=VALUE if the value begins with -"),
    "a crop outside the picture": (recover("--crop=-2,0,4,4"), r"crop.*-2"),
    "a setting of 400 digits": (recover("--set", f"particles={'9' * 400}"), r"particles must be at most 2147483647"),
    "a setting without end": (recover("--iterations", "5000000000", "--dry-run"), r"iterations must be at most"),
    "memory of 400 digits": (recover("--memory", f"{'9' * 400}G"), r"--memory 9+: write an amount"),
    "a setting that is not finite": (recover("--set", "c1=nan"), r"c1 must be a number"),
    "an even neighbourhood": (recover("--set", "neighbourhood=4"), r"neighbourhood must be odd"),
    "a search for nothing known": (recover("--search", "colour"), r"no parameter or stage 'colour'"),
    "a search of nine dimensions": (
        recover("--preset", "swarm", "--model", "cook_torrance_two_lobe", "--set", "normal=cartesian"), "9 dimensions"),
    "known of no such parameter": (recover("--fixed", "gloss=0.5"), r"no parameter 'gloss'"),
    "known without a value": (recover("--fixed", "roughness"), r"--fixed roughness: write NAME=VALUE"),
    "known of two numbers": (recover("--fixed", "base_color=0.5,0.5"), r"base_color has 3 numbers"),
    "known out of range": (recover("--fixed", "roughness=1.5"), r"roughness lies between 0.02 and 1"),
    "known that is not a number": (recover("--fixed", "roughness=nan"), r"--fixed roughness=nan.*finite"),
    "known that is no unit vector": (recover("--fixed", "normal=0,0,0"), r"--fixed normal=0,0,0.*length"),
    "known of no such file": (recover("--fixed", "normal=none.exr"), r"none.exr"),
    "known of another size": (
        lambda f: recover("--fixed", f"normal={f / 'normal_4.exr'}")(f), r"normal_4.exr.* is 4 × 3.* 8 × 6"),
    "everything known": (
        recover("--model", "lambert", "--fixed", "normal=0,0,1", "--fixed", "base_color=1"), r"parameter is fixed"),
    "a resolution of text": (recover("--resolution", "big"), r"--resolution big: give a whole number"),
    "a resolution of zero": (recover("--resolution", "0x8"), r"--resolution 0x8"),
    "a resolution past all limits": (recover("--resolution", "99999"), r"--resolution 99999"),
    "a resolution of a card": (recover("--resolution", "64"), r"--resolution is for meshes: give --blend"),
    "a seed of text": (recover("--seed", "seven"), r"--seed: seven is not a whole number"),
    "more particles than a GPU holds": (
        recover("--preset", "swarm", "--set", "particles=100000000"), r"lower .* the number of particles"),
    "more particles than move together": (
        recover("--preset", "standard", "--set", "particles=17"), r"at most 16 together, not 17; lower particles"),
    "an observation that is not there": (
        recover("--hold-out", "1,6"), r"--hold-out 1,6: '6' is no photograph; .*from 0 to 5"),
    "an observation twice": (recover("--hold-out", "1,1"), r"--hold-out 1,1"),
    "too many held out": (recover("--hold-out", "0,1,2,3"), r"without the photographs of --hold-out: has 2 lights"),
    "no ground truth there": (recover("--ground-truth", "none.exr"), r"none.exr: no such file"),
    "ground truth of no known map": (
        lambda f: recover("--ground-truth", f / "card" / "000.exr")(f), r"000.exr: holds no map of model metallic"),
    "ground truth of another size": (
        lambda f: recover("--ground-truth", f / "normal_4.exr")(f), r"normal is 4 × 3.*8 × 6"),
    "an object and no .blend": (recover("--object", "square"), r"--object is for meshes: give --blend"),
    "no shadows of a card": (recover("--no-shadows"), r"--no-shadows is for meshes: give --blend"),
    "an output that is a file": (with_file(OUT, "mine", "--seed", 1), r"out: is a file"),
    "an output below a file": (
        lambda f: recover("-o", f / "scene.blend" / "deep")(f), r"scene.blend: is a file.*-o"),
    "an output into the capture": (lambda f: recover("-o", f / "card")(f), r"card: holds the capture"),
    "an output beside a list of lights": (
        lambda f: recover("-o", f / "lists", capture="lists/filenames.txt")(f), r"lists: holds the capture"),
    "an output without a name": (recover("-o", ""), r"output folder has an empty name"),
    "nothing to resume": (recover("--resume"), r"out holds no checkpoint"),
    "a damaged checkpoint": (prepared(damaged_checkpoint, recover("--resume")), r"checkpoint.npz: is no checkpoint"),
    "an unknown colour space": (recover("--colour-space", "acescg"), r"--colour-space.*acescg"),
}  # fmt: skip

PRESETS = {
    "a preset that is no TOML": (preset("[swarm]", "[swarm"), r"mine.toml: is not valid TOML"),
    "a preset without a constant": (preset("inertia = 0.6\n", ""), r"mine.toml.*'inertia' is not set"),
    "a preset with an unknown key": (preset("inertia = 0.6", "inertia = 0.6\ninertias = 1"), r"mine.toml.*'inertias'"),
    "a preset of a later format": (preset("format = 3", "format = 4"), r"mine.toml: is of format 4; .* reads 1 to 3"),
    "a preset with unknown walls": (preset('walls = "stop"', 'walls = "soft"'), r"walls must be one of"),
    "a preset without stages": (preset('[[stage]]\nsearch = ["all"]\niterations = 1500', ""), r"no \[\[stage\]\]"),
    "a preset of text for a number": (preset("c1 = 1.2", 'c1 = "1.2"'), r"c1 must be a number"),
}

STRENGTH = 'name = "strength"\nrange = [0.0, 0.5]\nkind = "linear"'
IMAGES, SETTINGS = 'shader = "images"', 'shader = "principled"\n[material.settings]\n'
OWN_MODELS = {
    "a model that is no TOML": (model(old="[[parameter]]", new="[[parameter"), r"mine.toml: is not valid TOML"),
    "a model without parameters": (model(toml='title = "none"'), r"mine.toml: declares no \[\[parameter\]\]"),
    "parameters of the wrong kind": (model(toml="parameter = [1, 2]"), r"mine.toml: .*\[\[parameter\]\]"),
    "a model without a normal": (model(old="is_normal = true", new="components = 3"), r"exactly one .*is_normal"),
    "a model with an unknown key": (model(old="range", new="ranges"), r"mine.toml.*'strength'.*'ranges'"),
    "a range that falls": (model(old="[0.0, 0.5]", new="[0.5, 0.0]"), r"'strength': range must rise"),
    "a range that is not finite": (model(old="[0.0, 0.5]", new="[0.0, inf]"), r"'strength': range"),
    "a kind unknown": (model(old=STRENGTH, new=STRENGTH.replace("linear", "fixed")), r"'strength': kind must be"),
    "a default out of range": (model(old="[0.0, 0.5]", new="[0.0, 0.5]\ndefault = 2.0"), r"'strength': default"),
    "names that are no names": (model(old='"slope"', new='"Slope 1"'), r"'Slope 1': a name is"),
    "a name that GLSL needs": (model(old='"slope"', new='"half"'), r"'half': that is a word of GLSL"),
    "a range beyond float32": (model(old="[0.0, 0.5]", new="[0.0, 1e60]"), r"'strength': range must be two numbers up"),
    "two names alike": (model(old='"slope"', new='"strength"'), r"same name"),
    "a map of a name taken": (model(old='map = "roughness"', new='map = "residual"'), r"map 'residual'"),
    "a map of no name": (model(old='map = "roughness"', new="map = 3"), r"mine.toml: parameter 'slope': map"),
    "an unknown colour space of a map": (model(old='"sRGB"', new='"ACEScg"'), r"mine.toml.*'base_color': color_space"),
    "a shader that is not there": (model(glsl=""), r"mine.glsl is not beside it"),
    "a shader elsewhere": (model(old="title", new="shader = 'x/mine.glsl'\ntitle"), r"x/mine.glsl is not beside it"),
    "a shader's name that is empty": (model(old="title", new="shader = ''\ntitle"), r"mine.toml: its shader"),
    "a shader's name that is none": (model(old="title", new="shader = 3\ntitle"), r"mine.toml: shader must be"),
    "lobes ordered by a number": (model(old="title", new="ordered = 3\ntitle"), r"mine.toml: ordered"),
    "material settings of no table": (model(old="[material]\nshader", new="material = 3\n#"), r"mine.toml: "),
    "a material of no known socket": (
        model(old=IMAGES, new=SETTINGS + "Shine = 1"), r"'Shine'"),
    "a material of text for a number": (
        model(old=IMAGES, new=SETTINGS + 'IOR = "x"'), r"'IOR' cannot be 'x'"),
    "a material of an unknown distribution": (
        model(old=IMAGES, new=SETTINGS + 'distribution = "X"'), r"distribution must be GGX"),
    "two lobes without their parameters": (model(old='"images"', new='"two_lobe"'), r"two_lobe needs a parameter"),
    "a shader that does not compile": (
        model(old="float a2 = s.slope", new="float a2 = s.slop"), r"mine.glsl:18(:\d+)?: .*slop"),
    "a shader that includes nothing": (model(old="brdf/angles", new="brdf/angels"), r"mine.glsl:4: .*brdf/angels"),
    "a shader without its function": (model(glsl="// empty\n"), r"reflectance"),
}  # fmt: skip

RENDERS = {
    "a capture that is there": (prepared(fill_out, render()), r"out: is there already and not empty"),
    "no maps there": (render(maps="nowhere"), r"nowhere"),
    "maps of no known name": (render(maps="card/000.exr"), r"000.exr: holds no map"),
    "no camera": (render(blend="library.blend"), r"no active camera; name one with --camera"),
    "a mesh of another program": (
        prepared(lambda f: (f / "head.obj").touch(), render(blend="head.obj")),
        r"head.obj' is no .blend file; import it",
    ),
    "a camera that is not there": (render("--camera", "front"), r"--camera front"),
    "a mesh for a camera": (render("--camera", "square"), r"'square' is of type MESH, not a camera"),
    "a panorama": (render("--camera", "panorama"), r"'panorama' is panoramic"),
    "a size of text": (render("--size", "huge"), r"--size huge"),
    "a dome of nothing": (render("--dome", "0x4"), r"--dome 0x4"),
    "no file of lights": (render("--lights", "none.txt"), r"none.txt"),
    "lights of two numbers": (directions("0 0 1\n0 1\n"), r"lights.txt: line 2"),
    "a light of zero": (directions("0 0 0\n"), r"lights.txt: line 1"),
    "lights of words": (directions("up\n"), r"lights.txt: line 1"),
    "lights of nothing": (directions("\n"), r"lights.txt"),
}

GROUPS = (CAPTURES, MESHES, OPTIONS, PRESETS, OWN_MODELS, RENDERS)
CASES = {name: case for group in GROUPS for name, case in group.items()}
