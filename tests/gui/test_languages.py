"""The window in other languages: words follow the preference at once, and leave with the extension."""

import pytest

from irpso_addon.ui.translations.po import read_po
from irpso_addon.ui.translations.register import FOLDER

LANGUAGES = {"de_DE": "de", "es": "es", "fr_FR": "fr", "ja_JP": "ja", "zh_HANS": "zh_HANS"}  # Blender's → our file
SHOWN = "[translations.pgettext_iface(*key) for key in (('Recover', '*'), ('Find Lights', 'Operator'))]"
MODULE = "bl_ext.user_default.irpso"


@pytest.fixture(scope="module")
def ready(window):
    """The window with its tab open, in whatever language its tests choose."""
    window.run(
        "from bpy.app import translations\nview = bpy.context.preferences.view\nview.use_translate_tooltips = True"
    )
    if not window.run("translations.locales"):
        pytest.skip("this Blender has no list of languages")
    window.open_sidebar("IRPSO")
    yield window
    window.run("view.language = 'en_US'")


@pytest.mark.parametrize("name", LANGUAGES)
def test_the_words_follow_the_preference(ready, name):
    ready.run(f"view.language = {name!r}\nview.use_translate_interface = True", area="")
    words = read_po(FOLDER / f"{LANGUAGES[name]}.po")
    assert ready.run(SHOWN) == [words["Recover"], words["Find Lights"]]
    english = "Make the maps the material of the subject. Nodes that you have added to it stay"
    assert ready.run(f"translations.pgettext_tip({english!r}, 'Operator')") == words[english]
    ready.screenshot(f"panel in {name}", ready.region(region="UI"))


def test_a_tooltip_that_a_grey_button_gives_is_translated(ready):
    ready.run("view.language = 'de_DE'", area="")
    with pytest.raises(Exception, match="Keine Aufnahme"):
        ready.run("bpy.ops.irpso.check_capture()")


def test_disabled_the_extension_takes_its_words_with_it(ready):
    ready.run(f"view.language = 'ja_JP'\nimport addon_utils\naddon_utils.disable({MODULE!r})", area="")
    assert ready.run(SHOWN) == ["Recover", "Find Lights"]
    ready.run(f"addon_utils.enable({MODULE!r}) is not None", area="")
    assert ready.run(SHOWN)[0] == read_po(FOLDER / "ja.po")["Recover"]
