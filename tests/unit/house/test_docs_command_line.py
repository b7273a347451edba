"""The pages in docs/ against the command line that they describe."""

import argparse
import re
from pathlib import Path

import pytest

from irpso_addon import cli

DOCS = Path(__file__).resolve().parents[3] / "docs"
PAGES = "\n".join(path.read_text(encoding="utf-8") for path in sorted(DOCS.glob("*.md")))
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*")


def parsers() -> dict[str, argparse.ArgumentParser]:
    """Return the parsers of the commands, by name."""
    (action,) = [a for a in cli.build_parser()._actions if isinstance(a, argparse._SubParsersAction)]
    return dict(action.choices)


def options_of(parser: argparse.ArgumentParser) -> set[str]:
    return {option for action in parser._actions for option in action.option_strings if option.startswith("--")}


@pytest.mark.parametrize("command", parsers())
def test_every_command_is_described(command):
    assert f"irpso {command}" in PAGES


@pytest.mark.parametrize("command", parsers())
def test_every_option_of_a_command_is_described(command):
    # -o is shown by its short name; --quiet speaks for itself.
    assert options_of(parsers()[command]) - set(OPTION.findall(PAGES)) <= {"--output", "--quiet"}


def test_the_papers_experiment_and_make_demo_write_into_different_folders():
    makefile = (DOCS.parent / "Makefile").read_text(encoding="utf-8")
    default = cli.build_parser().parse_args(["demo"]).output
    demo, paper = (makefile.split(f"\n{target}:")[1].split("\n\n")[0] for target in ("demo", "paper"))
    assert default == "out/paper" and "-o $(OUT)/paper" in paper and "-o $(OUT)/demo" in demo


def test_no_option_is_described_that_does_not_exist():
    examples = [line for line in PAGES.splitlines() if line.startswith(("irpso ", "$ irpso "))]
    tables = [line.split("|")[1] for line in PAGES.splitlines() if line.startswith("| `--")]
    shown = set(OPTION.findall("\n".join([*examples, *tables])))
    assert shown and shown <= set().union(*map(options_of, parsers().values()))
