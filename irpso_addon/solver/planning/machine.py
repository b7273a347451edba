"""What this machine is, for people: the GPU, what it can hold, what will be used, and the versions of everything."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...gpu.context import is_software_vulkan
from ...gpu.probe import chosen_entry
from ...reflectance.model import shipped_models
from ...results.report import versions
from ..settings.schedule import shipped_presets

SOFTWARE_VULKAN = (
    "Software Vulkan crashes Blender after some hundred redraws of its window; save often, start Blender with"
    " --gpu-backend opengl, or raise the driver's limit: sudo sysctl -w vm.max_map_count=2000000"
)


def machine_facts(found: Mapping[str, Any]) -> dict[str, str]:
    """Return what ``gpu.probe.probe`` found, in words: name → fact, in reading order."""
    ratio = found["fragment_seconds"] / found["compute_seconds"]
    software_vulkan = is_software_vulkan(found["renderer"], found["backend"])
    return {
        **{f"version of {name}": value for name, value in versions().items()},
        "GPU": found["renderer"],
        "vendor": found["vendor"],
        "driver": found["version"],
        "backend": found["backend"] + (f"; {SOFTWARE_VULKAN}" if software_vulkan else ""),
        "largest texture": f"{found['max_texture_size']} texels, {found['max_texture_layers']} layers",
        "probe": f"right both ways; compute runs {ratio:.2f} times as fast as fragment passes",
        "passes used": chosen_entry(found),
        "models": ", ".join(shipped_models()),
        "presets": ", ".join(shipped_presets()),
    }


def fact_lines(facts: Mapping[str, str]) -> list[str]:
    """Return one line for each fact, the facts beneath each other."""
    width = max(map(len, facts))
    return [f"{name:{width}}  {value}" for name, value in facts.items()]
