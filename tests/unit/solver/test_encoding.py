"""The particle encoding of a stage: its GLSL, run as Python, is compared with the table of the model."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from irpso_addon.core.paths import PRESETS
from irpso_addon.reflectance.model import Parameter, ReflectanceModel, load_model
from irpso_addon.solver.kernels.encoding import build_encoding
from irpso_addon.solver.settings.resolve import resolve
from irpso_addon.solver.settings.schedule import load_schedule

TWO_LOBES = load_model("cook_torrance_two_lobe")


def encoding_of(search, model=TWO_LOBES, normal="hemisphere"):
    """Return the encoding of a stage that searches ``search``."""
    schedule = load_schedule("swarm").replaced(search=search, normal=normal)
    return build_encoding(model, resolve(schedule, model, set())[0], normal)


def functions_of(encoding):
    """Return decode(x, albedo_limit, s) and encode(s, albedo_limit) as Python functions: assignments are alike."""

    def body(name):
        lines = re.search(rf"void {name}\(.*?\) {{\n(.*?)\n}}", encoding.source, re.S).group(1).splitlines()
        lines = [re.sub(r"^(vec\d|float) ", "", line.strip().rstrip(";")) for line in lines]
        return "\n".join(line for line in lines if not line.startswith("for"))

    names = {
        "vec2": lambda *v: ("vec2", v),
        "vec3": lambda *v: ("vec3", v),
        "clamp": lambda v, low, high: min(max(v, low), high),
        "normal_from_hemisphere": lambda v: ("hemisphere", v),
        "normal_from_cartesian": lambda v: ("cartesian", v),
        "hemisphere_from_normal": lambda n: n[1][1],
        "cartesian_from_normal": lambda n: n[1][1],
    }

    def decode(x, albedo_limit, s):
        exec(body("decode"), names | {"x": x, "albedo_limit": albedo_limit, "s": s})

    def encode(s, albedo_limit):
        x = [0.0] * 8
        exec(body("encode"), names | {"x": x, "albedo_limit": albedo_limit, "s": s})
        return x

    return decode, encode


def material():
    """Return a material whose numbers are all out of any range."""
    return SimpleNamespace(base_color=[9.0] * 3, normal="untouched", r1=9.0, r2=9.0, w=9.0)


SEARCHES = [
    (["diffuse"], "hemisphere", 3),
    (["normal"], "hemisphere", 2),
    (["normal"], "cartesian", 3),
    (["specular"], "hemisphere", 3),
    (["diffuse", "normal"], "cartesian", 6),
    (["all"], "hemisphere", 8),
    (["r2", "base_color"], "hemisphere", 4),
]


@pytest.mark.parametrize(("search", "normal", "n"), SEARCHES)
def test_a_position_has_one_number_per_searched_dimension(search, normal, n):
    encoding = encoding_of(search, normal=normal)
    assert encoding.dimensions == encoding.defines["DIMENSIONS"] == n
    assert encoding.blocks == encoding.defines["BLOCKS"] == (1 if n <= 4 else 2)


@pytest.mark.parametrize(("search", "normal", "n"), SEARCHES)
@pytest.mark.parametrize("albedo_limit", [1.0, 0.25])
def test_a_position_decodes_into_the_ranges_and_encodes_back(search, normal, n, albedo_limit):
    decode, encode = functions_of(encoding_of(search, normal=normal))
    x = [float(v) for v in np.random.default_rng(n).uniform(0, 1, 8)]
    s = material()
    decode(x, albedo_limit, s)
    at = 0
    for p in TWO_LOBES.parameters:
        if not {"all", p.name, p.stage} & set(search):
            assert getattr(s, p.name) == getattr(material(), p.name)
        elif p.is_normal:
            size = 2 if normal == "hemisphere" else 3
            assert s.normal == (normal, (f"vec{size}", tuple(x[at : at + size])))
            at += size
        else:
            low, high = p.range
            high = min(high, albedo_limit) if p.kind == "linear" and p.components == 3 else high
            wanted = low + (high - low) * np.array(x[at : at + p.components])
            np.testing.assert_allclose(np.ravel(getattr(s, p.name)), wanted, rtol=1e-12)
            at += p.components
    assert at == n
    np.testing.assert_allclose(encode(s, albedo_limit), x[:n] + [0.0] * (8 - n), rtol=1e-12)


@pytest.mark.parametrize(("extent", "limit", "wanted"), [
    ((0.0, 0.1), 0.25, (0.0, 0.1)), ((0.1, 0.4), 0.25, (0.1, 0.25)), ((0.1, 0.4), 1e30, (0.1, 0.4)),
])  # fmt: skip
def test_the_limit_of_an_albedo_is_an_albedo_and_no_part_of_its_range(extent, limit, wanted):
    parameters = tuple(replace(p, range=extent) if p.is_albedo else p for p in TWO_LOBES.parameters)
    decode, _ = functions_of(encoding_of(["base_color"], replace(TWO_LOBES, parameters=parameters)))
    found = []
    for end in (0.0, 1.0):
        s = material()
        decode([end] * 8, limit, s)
        found.append(s.base_color)
    np.testing.assert_allclose(found, np.repeat(np.array(wanted)[:, None], 3, axis=1), rtol=1e-12)


def test_values_out_of_range_are_encoded_at_the_limit():
    _, encode = functions_of(encoding_of(["specular"]))
    s = material()
    s.r1 = -1.0
    assert encode(s, 1.0)[:3] == [0.0, 1.0, 1.0]


def test_the_normal_lies_at_the_offset_given_to_the_kernels():
    assert encoding_of(["all"]).defines["NORMAL_SIZE"] == 2 and encoding_of(["all"]).defines["NORMAL_AT"] == 3
    assert encoding_of(["normal"], normal="cartesian").defines["NORMAL_SIZE"] == 3
    assert encoding_of(["diffuse"]).defines["NORMAL_SIZE"] == 0


def test_lobes_are_kept_in_order_only_where_all_of_them_move():
    lobes = ("LOBE_FIRST", "LOBE_SECOND", "LOBE_WEIGHT")
    assert [encoding_of(["all"]).defines[name] for name in lobes] == [5, 6, 7]
    assert [encoding_of(["specular"]).defines[name] for name in lobes] == [0, 1, 2]
    for search in (["r1", "r2"], ["r1", "w"], ["diffuse"]):
        assert not set(lobes) & set(encoding_of(search).defines)


def test_lobes_without_a_weight_are_kept_in_order_too():
    parameters = (Parameter("normal", 3, is_normal=True, stage="normal"), Parameter("a"), Parameter("b"))
    model = ReflectanceModel("mine", "mine", PRESETS / "none.glsl", parameters, ordered=("a", "b"))
    defines = encoding_of(["a", "b"], model).defines
    assert (defines["LOBE_FIRST"], defines["LOBE_SECOND"]) == (0, 1) and "LOBE_WEIGHT" not in defines


def test_a_parameter_of_four_components_is_four_dimensions():
    parameters = (
        Parameter("normal", 3, is_normal=True, stage="normal"), Parameter("odd", 4, (-1.0, 3.0), (0.0,) * 4, "search")
    )  # fmt: skip
    model = ReflectanceModel("mine", "mine", PRESETS / "none.glsl", parameters)
    encoding = encoding_of(["all"], model)
    decode, _ = functions_of(encoding)
    s = SimpleNamespace(normal=None, odd=[0.0] * 4)
    decode([0.5, 0.5, 0.0, 0.25, 0.5, 1.0, 0, 0], 1.0, s)
    assert s.odd == [-1, 0, 1, 3] and encoding.dimensions == 6
