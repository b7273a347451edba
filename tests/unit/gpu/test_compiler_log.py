"""Reading what Blender writes where a shader does not compile: the logs are as its versions write them."""

import pytest

from irpso_addon.gpu.compiler import messages_of, places_of, rows_of

LOG_4_2 = """ERROR (gpu.shader): pyGPU_Shader FragShader: 
      | 
    2 | #extension GL_ARB_shader_draw_parameters : enable
      |              ^
      | Error: `a' undeclared
      | 
      | #extension GL_ARB_shader_draw_parameters : enable
      |    ^
      | common_math_lib.glsl:18:16: Error: operands to arithmetic operators must be numeric
      | Error: operands to arithmetic operators must be numeric
      | 
      | Error: nowhere
      | 
   17 | float error = 1.0;
      |  ^
      | preprocessor error: Unterminated #if
"""  # noqa: W291
NUMERIC = "Error: operands to arithmetic operators must be numeric"
LOG_5_0 = """00:01.358  gpu.shader       | \033[1;31mERROR\033[0m pyGPU_Shader ComputeShader: 
                            | \033[0;2m      | \033[0;0m
                            |   322 |  int q = zork;
                            |       |           ^
                            |       | \033[0;2mb/c.glsl:2:11: \033[0;0m\033[31;1mError\033[0;2m: `zork' undeclared
                            | \033[0;0m      | 
                            |       | b/c.glsl:3:3: Error: value of type vec2
"""  # noqa: W291


def test_messages_come_with_the_row_of_the_code_above_them():
    assert list(rows_of(LOG_4_2)) == [
        ("fragment", 2, "Error: `a' undeclared"),
        ("fragment", 2, NUMERIC),
        ("fragment", 2, NUMERIC),
        ("fragment", None, "Error: nowhere"),
        ("fragment", 17, "preprocessor error: Unterminated #if"),
    ]


@pytest.mark.parametrize(("word", "stage"), [("Vert", "vertex"), ("Frag", "fragment"), ("Compute", "compute")])
def test_the_shader_stage_is_read_from_its_logs_header(word, stage):
    log = LOG_4_2 + LOG_4_2.replace("Frag", word)
    assert [row[0] for row in rows_of(log)] == ["fragment"] * 5 + [stage] * 5


def test_a_linkers_message_has_no_row():
    log = "ERROR (gpu.shader): pyGPU_Shader Linking: \n      | Error: unresolved reference to function `g'\n"
    assert (
        list(rows_of(log))
        == list(rows_of(LOG_4_2 + log))[5:]
        == [(None, None, "Error: unresolved reference to function `g'")]
    )


def test_the_colours_of_a_terminal_do_not_hide_messages():
    expected = "b/c.glsl:2:11: Error: `zork' undeclared\nb/c.glsl:3:3: Error: value of type vec2"
    assert messages_of(LOG_5_0) == expected


def test_every_row_maps_to_its_file_and_line():
    source = '#line 1 "a.glsl"\nfloat a;\nfloat b;\n#line 1 "b.glsl"\nfloat c;\n'
    assert places_of(source) == [("a.glsl", 1), ("a.glsl", 1), ("a.glsl", 2), ("b.glsl", 1), ("b.glsl", 1)]
