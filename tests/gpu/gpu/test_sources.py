"""Shader sources: how includes are put together, and what is said where a shader does not compile."""

import re

import numpy as np
import pytest

from irpso_addon.core.errors import ShaderError
from irpso_addon.core.paths import SHADERS
from irpso_addon.gpu.compiler import messages_of
from irpso_addon.gpu.kernel import Kernel, Output
from irpso_addon.gpu.library import read_source
from irpso_addon.gpu.passes import Pass
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.kernels.single_passes import render_pass
from tests.gpu.gpu.test_passes import expected, marks

pytestmark = pytest.mark.usefixtures("gpu")


@pytest.fixture(params=["fragment", "compute"])
def entry(request):
    """Both entries."""
    return request.param


def write(folder, **files):
    """Write shader files; return the path of the first."""
    for name, text in files.items():
        (folder / f"{name}.glsl").write_text(text, encoding="utf-8")
    return folder / f"{next(iter(files))}.glsl"


KERNEL = "bool texel_kernel(ivec2 texel)\n{\n    o_value = vec4(half_of(1.0));\n    return true;\n}\n"


def test_includes_are_found_beside_the_file_then_in_the_library_and_appear_once(tmp_path):
    a = write(
        tmp_path,
        a='#include "b.glsl"\n#include "c.glsl"\n#include "common/random.glsl"\nfloat a;\n',
        b='#include "c.glsl"\nfloat b;\n',
        c="float c;\n",
    )
    source = read_source(a)
    order = [source.index(text) for text in ("float c;", "float b;", "uvec4 pcg4d", "float a;")]
    assert order == sorted(order)
    assert source.count("float c;") == 1
    assert re.findall(r'#line 1 "(.+)"', source) == ["c.glsl", "b.glsl", "common/random.glsl", "a.glsl"]


def test_given_sources_precede_files_of_the_same_name(tmp_path):
    a = write(tmp_path, a='#include "b.glsl"\nfloat a;\n', b="float wrong;\n", other="float right;\n")
    assert "float given;" in read_source(a, {"b.glsl": "float given;"})
    source = read_source(a, {"b.glsl": tmp_path / "other.glsl"})
    assert "float right;" in source and "float wrong;" not in source


def test_files_that_include_each_other_end(tmp_path):
    a = write(tmp_path, a='#include "b.glsl"\nfloat a;\n', b='#include "a.glsl"\nfloat b;\n')
    assert read_source(a).count("float a;") == 1


def test_a_missing_include_names_the_file_and_line_that_asks_for_it(tmp_path):
    a = write(tmp_path, a='float a;\n#include "b.glsl"\n', b='\n\n#include "brdf/none.glsl"\n')
    with pytest.raises(ShaderError) as caught:
        read_source(a)
    assert str(caught.value).startswith('b.glsl:3: #include "brdf/none.glsl" names no file')
    assert "\n" not in str(caught.value)


def test_a_missing_source_is_a_readable_error():
    with pytest.raises(ShaderError, match="names no file"):
        read_source("swarm/none.glsl")


@pytest.mark.parametrize(
    ("files", "where"),
    [
        ({"a": KERNEL}, "a.glsl:3"),
        ({"a": '\n#include "b.glsl"\n' + KERNEL, "b": "float half_of(float x) {\n    return x * y;\n}\n"}, "b.glsl:2"),
        ({"a": '#include "b.glsl"\n' + KERNEL, "b": "\n\nfloat half_of(float x) { return 0.5 * x }\n"}, "b.glsl:3"),
        ({"a": '#include "common/random.glsl"\n\n' + KERNEL}, "a.glsl:5"),
    ],
)
def test_a_compile_error_names_file_and_line(tmp_path, entry, files, where):
    path = write(tmp_path, **files)
    with pytest.raises(ShaderError) as caught:
        Pass(Kernel(path, (Output("o_value"),), {}, {}, {}), entry).compile()
    first, *lines = str(caught.value).splitlines()
    assert first == f"shader '{path}' does not compile"
    assert lines[0].startswith(where + ":") and "rror" in lines[0]
    assert all(re.match(r"\S+\.glsl:\d+:", line) for line in lines)


def test_an_error_in_a_users_model_names_its_own_file_and_line(tmp_path):
    table = (SHADERS / "models" / "lambert.toml").read_text(encoding="utf-8")
    (tmp_path / "mine.toml").write_text(table.replace('name = "lambert"', 'name = "mine"', 1), encoding="utf-8")
    shader = "vec3 reflectance(Material s, vec3 l, vec3 v)\n{\n    return s.base_colour;\n}\n"
    (tmp_path / "mine.glsl").write_text(shader, encoding="utf-8")
    with pytest.raises(ShaderError) as caught:
        render_pass(load_model(tmp_path / "mine.toml"), {"CARD": 1}).compile()
    assert "\nmine.glsl:3:" in str(caught.value) and "base_colour" in str(caught.value)


def test_a_shader_compiles_after_a_failed_one(tmp_path, entry):
    path = write(tmp_path, a=KERNEL)
    with pytest.raises(ShaderError):
        Pass(Kernel(path, (Output("o_value"),), {}, {}, {}), entry).compile()
    np.testing.assert_array_equal(marks(entry, 9, 7)[0], expected(9, 7))


LOG = """00:00.484  gpu.shader       | ERROR pyGPU_Shader FragShader:
                            |       |
                            |   317 |     o_value = foo(1.0);
                            |       |             ^
                            |       | bad.glsl:4:9: Error: no function with name 'foo'
                            |       | bad.glsl:4:9: Error: no function with name 'foo'
                            |       | my own.glsl:12: warning: unused
                            |
"""


def test_a_log_is_reduced_to_its_errors():
    assert messages_of(LOG) == "bad.glsl:4:9: Error: no function with name 'foo'"
    assert messages_of(LOG.replace("Error", "note")).splitlines()[-1] == "my own.glsl:12: warning: unused"


def test_a_log_without_places_is_kept_as_it_is():
    assert messages_of("  Linking:\n  Error: unresolved reference\n") == "Linking:\n  Error: unresolved reference"
    assert messages_of("") == ""
