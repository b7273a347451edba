"""The two files of a user's model: their digest, their encoding."""

import shutil

import pytest

from irpso_addon.core.errors import InputError
from irpso_addon.core.paths import MODELS
from irpso_addon.gpu.library import read_source
from irpso_addon.reflectance.model import digest_of_own_model, load_model, shipped_models


@pytest.fixture
def mine(tmp_path):
    """The path of a model of the user's, in a folder of its own."""
    for kind in ("toml", "glsl"):
        shutil.copy(MODELS / f"lambert.{kind}", tmp_path / f"mine.{kind}")
    return tmp_path / "mine.toml"


def test_the_digest_is_of_all_files_that_give_the_radiance(mine):
    shader, terms = mine.with_suffix(".glsl"), mine.with_name("terms.glsl")
    terms.write_text("const float K = 1.0;\n", encoding="utf-8")
    shader.write_text('#include "terms.glsl"\n' + shader.read_text(encoding="utf-8"), encoding="utf-8")
    digests = [digest_of_own_model(mine)]
    for file in (mine, shader, terms):
        with file.open("a", encoding="utf-8") as text:
            text.write("\n")
        digests.append(digest_of_own_model(mine))
    assert len(set(digests)) == 4
    mine.with_name("other.glsl").write_text("", encoding="utf-8")
    assert digest_of_own_model(mine) == digests[-1]
    assert digest_of_own_model("lambert") is digest_of_own_model(mine.with_name("gone.toml")) is None


@pytest.mark.parametrize(
    "definition",
    [
        "float deviance_unit(float noise) { if (noise > 0.0) { return noise; } return 0.0; }",
        "highp vec3[2] deviance_unit(vec3[2] noise) { return noise; }",
        "  #  define SUPPORT_TAPS 4",
        "const highp float MINE = 2.0, MAX_DEVIANCE = 1.0;",
        "struct Pooled { float x; };",
    ],
)
def test_a_name_of_a_pass_is_refused_before_anything_runs(mine, definition):
    shader = mine.with_suffix(".glsl")
    shader.write_text(f"// {definition}\n/* {definition} */\n" + shader.read_text(encoding="utf-8"), encoding="utf-8")
    load_model(mine)
    mine.with_name("terms.glsl").write_text(definition + "\n", encoding="utf-8")
    shader.write_text('#include "terms.glsl"\n' + shader.read_text(encoding="utf-8"), encoding="utf-8")
    with pytest.raises(InputError, match=r"terms.glsl: '\w+' is a name of the program .*; begin your own names with"):
        load_model(mine)
    mine.with_name("terms.glsl").write_text("float of_mine(float x) { return x; }\n", encoding="utf-8")
    load_model(mine)  # in the same session


def test_a_use_of_a_passes_name_inside_a_function_is_no_definition(mine):
    mine.with_name("terms.glsl").write_text(
        "float of_mine(float x)\n{\nconst float SMALL = 2.0;\nfloat lit = x;\nif (x > SMALL) {\nreturn max(lit, x);\n}"
        "\nreturn solve;\n}\n", encoding="utf-8",
    )  # fmt: skip
    shader = mine.with_suffix(".glsl")
    shader.write_text('#include "terms.glsl"\n' + shader.read_text(encoding="utf-8"), encoding="utf-8")
    load_model(mine)


@pytest.mark.parametrize("name", shipped_models())
def test_copies_of_the_shipped_models_define_no_name_of_a_pass(name, tmp_path):
    for kind in ("toml", "glsl"):
        shutil.copy(MODELS / f"{name}.{kind}", tmp_path / f"mine.{kind}")
    assert load_model(tmp_path / "mine.toml").parameters == load_model(name).parameters


def test_a_files_name_with_blanks_and_quotes_leaves_the_line_marks_whole(tmp_path):
    (tmp_path / 'my "own" model.glsl').write_text("float a;\n", encoding="utf-8")
    assert '#line 1 "my__own__model.glsl"' in read_source(tmp_path / 'my "own" model.glsl')


def test_files_of_editors_that_write_a_byte_order_mark_are_read(mine):
    for file in (mine, mine.with_suffix(".glsl")):
        file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())
    assert load_model(mine).bases == load_model("lambert").bases
    assert "\ufeff" not in read_source(load_model(mine).shader)


def test_a_shader_that_is_no_utf_8_is_refused(mine):
    shader = mine.with_suffix(".glsl")
    shader.write_bytes("// Lambert, gezähmt\n".encode("latin-1") + shader.read_bytes())
    with pytest.raises(InputError, match="mine.glsl: cannot be read .*; save it as UTF-8"):
        load_model(mine)
    with pytest.raises(InputError, match="mine.glsl: cannot be read .*; save it as UTF-8"):
        read_source(shader)
