"""GLSL of the shaders that Blender's translation to Metal has no equivalent for."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
SHADERS = sorted((ROOT / "shaders").rglob("*.glsl"))
# Neither the Metal Shading Language nor Blender's headers for it, which add inverse() and more, have these.
MISSING = re.compile(r"\b(outerProduct|matrixCompMult|dFdxFine|dFdxCoarse|textureGatherOffsets)\s*\(")
STRUCTS = {name for path in SHADERS for name in re.findall(r"^struct +(\w+)", path.read_text(), re.M)}
CONSTRUCTOR = re.compile(rf"(?<!struct )\b({'|'.join(sorted(STRUCTS))})\(")


def lines_with(pattern):
    return [
        f"{path.relative_to(ROOT)}: {line.strip()}"
        for path in SHADERS
        for line in path.read_text(encoding="utf-8").splitlines()
        if pattern.search(line.partition("//")[0])
    ]


def test_the_structs_are_found():
    assert {"Texel", "Observation", "Sums"} <= STRUCTS


@pytest.mark.parametrize("pattern", [MISSING, CONSTRUCTOR], ids=["functions", "constructors of structs"])
def test_no_shader_uses_what_metal_lacks(pattern):
    assert lines_with(pattern) == []
