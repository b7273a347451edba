"""The window's words in other languages: complete, with the same placeholders, and registered with Blender."""

import itertools
import re
import string
import sys
from contextlib import suppress
from pathlib import Path

import bpy
import pytest

import irpso_addon
from irpso_addon.core.errors import InputError
from irpso_addon.ui.common.drawing import lines_of
from irpso_addon.ui.translations import register
from irpso_addon.ui.translations.po import read_po
from irpso_addon.ui.translations.register import FOLDER, LOCALES
from irpso_addon.ui.translations.register import words as registered_words

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "scripts"))
pytestmark = pytest.mark.bpy_only
SAME = 0.12  # most of a file's texts may be as in English: names, units, words of both languages


@pytest.fixture
def words():
    """The module that finds the words, with the add-on registered."""
    irpso_addon.register()
    import translations

    yield translations
    irpso_addon.unregister()


def placeholders(text):
    """Return what a text puts in: names and formats, and its plain percent signs."""
    fields = sorted(f"{name}:{spec}" for _, name, spec, _ in string.Formatter().parse(text) if name is not None)
    return fields, text.count("%")


@pytest.mark.parametrize("locale", LOCALES)
def test_every_word_of_the_window_is_translated_and_no_other(words, locale):
    there, wanted = read_po(FOLDER / f"{locale}.po").keys(), set(words.words())
    assert sorted(wanted - there) == [], "run scripts/translations.py, then translate"
    assert sorted(there - wanted) == [], "run scripts/translations.py"


@pytest.mark.parametrize("locale", LOCALES)
def test_the_file_is_as_the_script_writes_it(words, locale):
    found = (FOLDER / f"{locale}.po").read_text(encoding="utf-8")
    assert found == words.updated(locale, words.words()), "run scripts/translations.py"


@pytest.mark.parametrize("locale", LOCALES)
def test_a_translation_puts_in_the_same_values_and_keeps_spaces_and_ends(locale):
    faults = []
    for text, translation in read_po(FOLDER / f"{locale}.po").items():
        ends = [
            (t[: len(t) - len(t.lstrip())], t[len(t.rstrip()) :], t.rstrip().endswith("…")) for t in (text, translation)
        ]
        if placeholders(text) != placeholders(translation) or ends[0] != ends[1] or translation.rstrip()[-1] in ".。":
            faults.append((text, translation))
    assert faults == []


@pytest.mark.parametrize("locale", LOCALES)
def test_the_file_is_in_its_language(locale):
    found = read_po(FOLDER / f"{locale}.po")
    same = [text for text, translation in found.items() if text == translation]
    assert len(same) < SAME * len(found), same
    if locale in ("ja", "zh_HANS"):
        latin = [t for t in found.values() if not re.search(r"[\u3040-\u30ff\u4e00-\u9fff]", t)]
        assert len(latin) < SAME * len(found), latin


def test_no_panel_shows_a_text_without_asking_for_its_translation(words):
    assert words.faults() == []


@pytest.mark.parametrize(
    ("code", "found"),
    [
        ("layout.label(text='One')", [("One", "")]),
        ("layout.operator('a.b', text='Two' if kept else 'Three')", [("Two", ""), ("Three", "")]),
        ("layout.label(text=iface('{n} lights', n=3))", [("{n} lights", "")]),
        ("layout.label(text=f'{n} lights')", [("f'{n} lights'", "an f-string is not translated")]),
        ("layout.label(text=f'{n:.0%}')", []),
        ("drawing.wrapped(layout, context, 'Four', 'INFO')", [("Four", "wrapped() shows it in English")]),
        ("self.report({'INFO'}, f'{n} files')", [("f'{n} files'", "report() shows it in English")]),
        ("self.report({'ERROR'}, 'Five')", []),
        ("usable(cls, there, 'Six')", [("Six", "")]),
        ("workspace.status_text_set('Seven')", [("Seven", "status_text_set() shows it in English")]),
    ],
)
def test_words_are_found_in_code(words, code, found):
    assert list(words.in_source(code)) == found


def test_blender_has_the_words_of_every_language_in_both_contexts():
    found = registered_words()
    assert found.keys() == set(LOCALES)
    assert found["de"]["*", "Recover"] == found["de"]["Operator", "Recover"] != "Recover"


def test_a_tooltip_stands_in_one_line(words):
    names = [name for name in dir(bpy.ops.irpso) if not name.startswith("_")]
    texts = {name: getattr(bpy.ops.irpso, name).get_rna_type().description for name in names}
    assert {name for name, text in texts.items() if "\n" in text or "  " in text} == set()


def test_every_stage_of_the_shipped_schedules_has_a_title_in_the_users_language(words, monkeypatch):
    from irpso_addon.reflectance.model import load_model, shipped_models
    from irpso_addon.solver.settings.resolve import resolve
    from irpso_addon.solver.settings.schedule import load_schedule, shipped_presets
    from irpso_addon.ui.panels import recovery
    from irpso_addon.ui.panels.recovery import stage_text

    german = read_po(FOLDER / "de.po")
    monkeypatch.setattr(recovery, "iface", lambda text, **values: german.get(text, "English").format(**values))
    models = [load_model(name) for name in shipped_models()]
    titles = set()
    for schedule, model in itertools.product(map(load_schedule, shipped_presets()), models):
        with suppress(InputError):  # a preset that cannot search all parameters of a model together
            titles |= {stage.title for stage in resolve(schedule, model, set(), 96)}
    assert len(titles) > 10 and [title for title in titles if "English" in stage_text(title)] == []
    assert stage_text("roughness + base_color") == f"{german['Roughness']}, {german['Base Color']}"
    later = stage_text("surface at 1/2, round 2 of interreflection")
    assert german["Surface"] in later and "round" not in later and "2" in later and "1/2" in later


def test_a_po_file_is_read_with_its_quotes_joined_and_without_fuzzy_entries(tmp_path):
    path = tmp_path / "xx.po"
    path.write_text(
        '# Head\nmsgid ""\nmsgstr "Language: xx\\n"\n\n#. note\nmsgid "a \\"b\\""\nmsgstr ""\n"one "\n"two"\n\n'
        '#, fuzzy\nmsgid "c"\nmsgstr "d"\n\nmsgid "e"\nmsgstr ""\n',
        encoding="utf-8",
    )
    assert read_po(path) == {'a "b"': "one two"}
    path.write_text('msgid "a"\nmsgstr "b"\n\nmsgid "a"\nmsgstr "c"\n', encoding="utf-8")
    with pytest.raises(ValueError, match="stands twice"):
        read_po(path)


def test_japanese_is_wrapped_between_characters_and_no_line_begins_with_a_full_stop():
    text = "写真の光源を探します。IRPSO は球を検出します、次に読み込みます"
    lines = lines_of(text, 16)
    assert "".join(lines).replace(" ", "") == text.replace(" ", "") and len(lines) > 3
    assert all(line[0] not in "。、" for line in lines)
    assert max(sum(2 if ord(c) > 0x2E80 else 1 for c in line) for line in lines) <= 18
    assert lines_of("plain words in English", 12) == ["plain words", "in English"]


def test_a_file_that_cannot_be_read_costs_its_own_language_alone(monkeypatch, tmp_path, capsys):
    for locale in LOCALES:
        entry = 'msgid "Recover"\nmsgstr "x"\n'
        (tmp_path / f"{locale}.po").write_text(entry + ("\n" + entry if locale == "de" else ""), encoding="utf-8")
    monkeypatch.setattr(register, "FOLDER", tmp_path)
    assert sorted(registered_words()) == sorted(set(LOCALES) - {"de"})
    assert "de.po: 'Recover' stands twice; its texts are English" in capsys.readouterr().err
