"""Results of ``recover`` by model, each made once, for the tests of the command line."""

import functools
import json

import numpy as np

from irpso_addon.capture.images.exr import write_exr
from tests.builders import command_line as cli_maker
from tests.builders.command_line import MODELS, run_cli

SHAPE = (18, 24)
LIGHTS = cli_maker.dome_lights(36, widest=75)
RANGES = {
    "lambert": {},
    "principled": {"roughness": (0.25, 0.6), "specular": (0.3, 0.8)},
    "cook_torrance_two_lobe": {"r1": (0.15, 0.25), "r2": (0.4, 0.6), "w": (0.4, 0.7)},
    "ward": {"strength": (0.1, 0.3), "slope": (0.15, 0.4)},
    "oren_nayar": {"sigma": (0.2, 0.8)},
}
OWN = {"ward", "oren_nayar"}
# Seen along the normal, σ and albedo compensate each other to within 0.1 % of the radiance: the albedo is fixed.
KNOWN = {"oren_nayar": "base_color"}


def recovered_models(tmp_path_factory):
    """Return a function: model → (true maps, the result's folder, the output of --json); it recovers each once."""
    folder = tmp_path_factory.mktemp("recovered")

    @functools.cache
    def recover(name):
        values = cli_maker.smooth_maps(SHAPE, RANGES[name], seed=3)
        capture = cli_maker.write_card(folder / name, cli_maker.render_oracle(name, values, LIGHTS), LIGHTS)
        model = MODELS / f"{name}.toml" if name in OWN else name
        out = folder / f"{name} out"
        options = ["--iterations", 500, "--seed", 5, "-o", out, "--json"]
        if name in KNOWN:
            fixed = values[KNOWN[name]].astype(np.float32)
            write_exr(folder / "known.exr", {"": {c: fixed[..., i] for i, c in enumerate("RGB")}})
            options += ["--fixed", f"{KNOWN[name]}={folder / 'known.exr'}"]
        code, answer, err = run_cli("recover", capture, "--model", model, *options)
        assert (code, err) == (0, "")
        return values, out, json.loads(answer.splitlines()[-1])

    return recover


FILES = {
    "lambert": {"base_color", "normal"},
    "principled": {"base_color", "normal", "roughness", "specular"},
    "cook_torrance_two_lobe": {"base_color", "normal", "roughness_lobes"},
}
OTHERS = {
    "residual.exr",
    "confidence.exr",
    "confidence.png",
    "maps.exr",
    "report.json",
    "preview.png",
    "convergence.png",
    "material.blend",
}
