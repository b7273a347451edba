"""Facts about this machine for display: GPU, limits, chosen passes, versions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...gpu.context import is_software_vulkan
from ...gpu.probe import chosen_entry
from ...gpu.versions import versions
from ...reflectance.model import shipped_models
from ..settings.schedule import shipped_presets

SOFTWARE_VULKAN = (
    "Software Vulkan crashes Blender after some hundred window redraws; save often, start Blender with"
    " --gpu-backend opengl, or raise the driver's limit: sudo sysctl -w vm.max_map_count=2000000"
)


def machine_facts(probed: Mapping[str, Any]) -> dict[str, str]:
    """Return the result of ``gpu.probe.probe`` in words: name → fact, in display order."""
    ratio = probed["fragment_seconds"] / probed["compute_seconds"]
    software_vulkan = is_software_vulkan(probed["renderer"], probed["backend"])
    return {
        **{f"version of {name}": value for name, value in versions().items()},
        "GPU": probed["renderer"],
        "vendor": probed["vendor"],
        "driver": probed["version"],
        "backend": probed["backend"] + (f"; {SOFTWARE_VULKAN}" if software_vulkan else ""),
        "largest texture": f"{probed['max_texture_size']} texels, {probed['max_texture_layers']} layers",
        "probe": f"right both ways; compute runs {ratio:.2f} times as fast as fragment passes",
        "passes used": chosen_entry(probed),
        "models": ", ".join(shipped_models()),
        "presets": ", ".join(shipped_presets()),
    }


def fact_lines(facts: Mapping[str, str]) -> list[str]:
    """Return one line per fact, aligned."""
    width = max(map(len, facts))
    return [f"{name:{width}}  {value}" for name, value in facts.items()]
