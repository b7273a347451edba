"""Updates irpso_addon/ui/translations/*.po: adds the window's new texts, untranslated, and removes old ones.

Usage: python scripts/translations.py, in an environment with bpy. A test fails while texts are missing or stale.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import bpy  # noqa: E402

from irpso_addon.core.paths import DEFAULT_MODEL  # noqa: E402
from irpso_addon.reflectance.model import load_model, shipped_models  # noqa: E402
from irpso_addon.solver.settings.resolve import resolve  # noqa: E402
from irpso_addon.solver.settings.schedule import load_schedule, shipped_presets  # noqa: E402
from irpso_addon.solver.views.held_out import RELIT_LINES  # noqa: E402
from irpso_addon.ui.operators.presets import purpose_of, title_of  # noqa: E402
from irpso_addon.ui.registration import MODULES  # noqa: E402
from irpso_addon.ui.translations.po import read_po  # noqa: E402
from irpso_addon.ui.translations.register import FOLDER, LOCALES  # noqa: E402

UI = ROOT / "irpso_addon" / "ui"
_OBSERVATIONS = 96  # enough for all phases of a schedule
_MARKED = {"iface", "rpt", "tip", "n_"}  # functions of ui/common/words.py
_DRAWN = {"text", "heading"}  # arguments that Blender translates
_PLACED = {"fact": (2, 3), "wrapped": (None, 2), "usable": (2, None), "report": (None, 1), "text": (None, 0),
           "chip": (None, 0), "status_text_set": (None, 0)}  # see _of_call  # fmt: skip


def words() -> list[str]:
    """Return every text that Blender or the panels translate, each once, in a fixed order."""
    texts: dict[str, None] = {}
    for name in MODULES:
        for cls in getattr(import_module(f"irpso_addon.ui.{name}"), "CLASSES", ()):
            texts |= dict.fromkeys(_of_class(cls))
    for path in sorted(UI.rglob("*.py")):
        texts |= dict.fromkeys(text for text, fault in in_source(path.read_text(encoding="utf-8")) if not fault)
    texts |= dict.fromkeys(_of_data())
    return [text for text in texts if any(map(str.isalpha, text))]


def faults() -> list[str]:
    """Return the places in the source that show a text without translation."""
    return [
        f"{path.relative_to(ROOT)}: {text}: {fault}"
        for path in sorted(UI.rglob("*.py"))
        for text, fault in in_source(path.read_text(encoding="utf-8"))
        if fault
    ]


def _of_class(cls: type) -> Iterator[str]:
    """Yield label, tooltip, and the names and tooltips of properties and enum items of a registered class."""
    yield getattr(cls, "bl_label", "")
    if issubclass(cls, bpy.types.Operator):
        yield " ".join((cls.__doc__ or "").split())
    ours = (base for base in cls.__mro__ if base.__module__.startswith("irpso_addon"))
    names = dict.fromkeys(name for base in ours for name in vars(base).get("__annotations__", {}))
    rna = _rna(cls).properties
    for one in (rna[name] for name in names if name in rna):
        if one.is_hidden or one.name == one.identifier:  # without a name of its own no panel shows it
            continue
        yield one.name
        yield one.description
        for item in getattr(one, "enum_items_static", ()):
            yield item.name
            yield item.description


def _rna(cls: type) -> Any:
    """Return Blender's description of a registered class; an operator's has its properties only here."""
    if not issubclass(cls, bpy.types.Operator):
        return cls.bl_rna  # type: ignore[attr-defined]
    module, _, name = cls.bl_idname.partition(".")
    return getattr(getattr(bpy.ops, module), name).get_rna_type()


def _of_data() -> Iterator[str]:
    """Yield the texts of shipped presets and models, of the phases of a recovery, and of its relit photographs."""
    yield from RELIT_LINES
    models = [load_model(name) for name in shipped_models()]
    for parameter in (parameter for model in models for parameter in model.parameters):
        yield bpy.path.display_name(parameter.name)
    for schedule in map(load_schedule, shipped_presets()):
        yield title_of(schedule)
        yield purpose_of(schedule)
        names = {parameter.name for parameter in load_model(DEFAULT_MODEL).parameters}
        stages = resolve(schedule, load_model(DEFAULT_MODEL), set(), _OBSERVATIONS)
        titles = [stage.title for stage in stages if not names & set(stage.title.split(" + "))]
        yield from (title[:1].upper() + title[1:] for title in titles)


def in_source(source: str) -> Iterator[tuple[str, str]]:
    """Yield (text, "") for texts in Python code that are translated, (text, fault) for those that should be.

    A text is translated if it is the first argument of ``iface``, ``rpt``, ``tip`` or ``n_``, an argument that Blender
    translates, or one that the panels' helpers pass on.
    """
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call):
            yield from _of_call(node)


def _of_call(call: ast.Call) -> Iterator[tuple[str, str]]:
    name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
    if name in _MARKED and call.args:
        first = call.args[0]
        if isinstance(first, ast.Constant):
            yield first.value, ""
        elif isinstance(first, ast.JoinedStr):
            yield ast.unparse(first), f"{name}() takes a constant, and values by name"
    shown = [keyword.value for keyword in call.keywords if keyword.arg in _DRAWN]
    passed_on, english = _PLACED.get(name, (None, None))
    if passed_on is not None:
        shown += call.args[passed_on : passed_on + 1]
    for text, is_shape in (found for argument in shown for found in _texts(argument)):
        yield text, "an f-string is not translated" if is_shape else ""
    if english is not None and len(call.args) > english and not _is_error(name, call):
        yield from ((text, f"{name}() shows it in English") for text, _ in _texts(call.args[english]))


def _is_error(name: str, call: ast.Call) -> bool:
    """Whether a call reports an error, which stays English, or is another function called report."""
    kind = call.args[0]
    return name == "report" and (not isinstance(kind, ast.Set | ast.IfExp) or "'ERROR'" in ast.unparse(kind))


def _texts(node: ast.expr) -> Iterator[tuple[str, bool]]:
    """Yield the texts with letters that an expression may evaluate to, and whether each is an f-string."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str) and any(map(str.isalpha, node.value)):
        yield node.value, False
    elif isinstance(node, ast.JoinedStr):
        literal = "".join(part.value for part in node.values if isinstance(part, ast.Constant))
        if any(map(str.isalpha, literal)):
            yield ast.unparse(node), True
    elif isinstance(node, ast.IfExp):
        yield from _texts(node.body)
        yield from _texts(node.orelse)
    elif isinstance(node, ast.BinOp):
        yield from _texts(node.left)
        yield from _texts(node.right)


def quoted(text: str) -> str:
    """Return a text quoted for .po."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
    return f'"{escaped}"'


def updated(locale: str, texts: list[str]) -> str:
    """Return a language's file with exactly these texts, its header and its existing translations."""
    path = FOLDER / f"{locale}.po"
    head, known = path.read_text(encoding="utf-8").partition("\n\n")[0], read_po(path)
    entries = [f"msgid {quoted(text)}\nmsgstr {quoted(known.get(text, ''))}" for text in texts]
    return "\n\n".join([head, *entries]) + "\n"


def main() -> None:
    """Update all files."""
    texts = words()
    for locale in LOCALES:
        (FOLDER / f"{locale}.po").write_text(updated(locale, texts), encoding="utf-8")
        missing = len(set(texts) - read_po(FOLDER / f"{locale}.po").keys())
        print(f"{locale}.po: {len(texts)} texts, {missing} without a translation")


if __name__ == "__main__":
    import irpso_addon

    irpso_addon.register()
    print(*faults(), sep="\n")
    main()
