"""``doctor``: what GPU there is, its limits, and what will be used."""

from __future__ import annotations

import sys
from argparse import Namespace

from ..gpu import probe
from ..maps.report import versions
from ..reflectance.model import shipped_models
from ..solver.schedule import shipped_presets


def run(options: Namespace) -> dict:
    """Probe the GPU in a child process and print what it is. Raises GpuUnavailableError."""
    found = probe.probe()
    ratio = found["fragment_seconds"] / found["compute_seconds"]
    entry = probe.chosen_entry(found)
    facts = {
        **{f"version of {name}": value for name, value in versions().items()},
        "GPU": found["renderer"],
        "vendor": found["vendor"],
        "driver": found["version"],
        "backend": found["backend"],
        "largest texture": f"{found['max_texture_size']} texels, {found['max_texture_layers']} layers",
        "probe": f"right both ways; compute runs {ratio:.2f} times as fast as fragment passes",
        "passes used": entry,
        "models": ", ".join(shipped_models()),
        "presets": ", ".join(shipped_presets()),
    }
    if not options.json:
        width = max(map(len, facts))
        sys.stdout.write("".join(f"{name:{width}}  {value}\n" for name, value in facts.items()))
    return {**found, "entry": entry, "versions": versions()}
