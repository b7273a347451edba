"""Operations and fetches of a kernel: small kernels against numbers counted by hand."""

import shutil

import pytest

from benchmarks.spirv import counts
from irpso_addon.gpu.kernel import Kernel, Output

pytestmark = pytest.mark.skipif(
    not all(map(shutil.which, ("glslangValidator", "spirv-opt", "spirv-dis"))),
    reason="glslang-tools or spirv-tools is not installed",
)
CONSTANTS = {"u_count": "INT", "u_factor": "FLOAT"}


def counted(tmp_path, body, *known):
    source = tmp_path / "kernel.glsl"
    source.write_text(f"bool texel_kernel(ivec2 texel)\n{{\n{body}\nreturn true;\n}}\n", encoding="utf-8")
    samplers = {"u_stack": "FLOAT_2D_ARRAY", "u_other": "FLOAT_2D", "u_unread": "FLOAT_2D"}
    kernel = Kernel(source, (Output("o_value"),), samplers, CONSTANTS, {"SIZE": 3})
    return counts(kernel, *(known or ({},)))


def test_plain_arithmetic_counts_its_components(tmp_path):
    found = counted(tmp_path, "vec4 a = texelFetch(u_other, texel, 0);\no_value = a * a + vec4(dot(a, a));")[0]
    # Two conversions of the place; four products, four sums; a dot product of four numbers: four products, three sums.
    assert found.operations == 2 + 8 + 7
    assert found.fetches == {"u_other": 1}


def test_roots_count_four_and_divisions_five(tmp_path):
    assert counted(tmp_path, "o_value = vec4(sqrt(gl_FragCoord.z));")[0].operations == 4
    assert counted(tmp_path, "o_value = vec4(gl_FragCoord.z / gl_FragCoord.w);")[0].operations == 5


def test_a_loop_counts_as_often_as_its_bound_says(tmp_path):
    body = (
        "vec4 sum = vec4(0.0);\nfor (int k = 0; k < u_count; k++) { sum += texelFetch(u_stack, ivec3(texel, k), 0); }\n"
    )
    few, many = counted(tmp_path, f"{body}o_value = sum;", {"u_count": 2}, {"u_count": 12})
    assert (few.fetches, many.fetches) == ({"u_stack": 2}, {"u_stack": 12})
    # A turn: a sum of four, the counter, and the test.
    assert many.operations - few.operations == 10 * (4 + 1 + 1)


def test_a_loop_to_another_loops_counter_counts_half_as_often(tmp_path):
    body = """
    float sum = 0.0;
    for (int i = 0; i < u_count; i++) {
        for (int j = 0; j < i; j++) { sum += texelFetch(u_stack, ivec3(texel, j), 0).x; }
    }
    o_value = vec4(sum);"""
    assert counted(tmp_path, body, {"u_count": 9})[0].fetches == {"u_stack": 9 * 8 / 2}


def test_a_loop_ends_at_the_width_of_a_texture(tmp_path):
    body = """
    float sum = 0.0;
    for (int i = 0; i < textureSize(u_other, 0).x; i++) { sum += texelFetch(u_other, ivec2(i, 0), 0).x; }
    o_value = vec4(sum);"""
    assert counted(tmp_path, body, {"u_other": 7})[0].fetches == {"u_other": 7}


def test_a_loop_that_ends_by_data_is_an_error(tmp_path):
    body = "float sum = gl_FragCoord.z;\nwhile (sum < 9.0) { sum = sum * u_factor + 1.0; }\no_value = vec4(sum);"
    with pytest.raises(ValueError, match="not"):
        counted(tmp_path, body, {"u_factor": 1.0})
