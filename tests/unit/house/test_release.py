"""The parts of `make release` that build no zip: notes cut from the changelog, refusals, checksums."""

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
CHANGELOG = """# Changelog

## [Unreleased]

- Later.

## [0.2.0] - 2027-01-31

### Fixed

- A map.

## [0.1.0] - 2026-11-24

The first release.
"""


@pytest.fixture
def release(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "scripts")
    return importlib.import_module("release")


def test_the_notes_are_the_versions_own_section_of_the_changelog(release):
    assert release.notes(CHANGELOG, "0.2.0") == "### Fixed\n\n- A map.\n"
    assert release.notes(CHANGELOG, "0.1.0") == "The first release.\n"


@pytest.mark.parametrize(
    "changelog",
    [
        CHANGELOG,
        CHANGELOG + "\n## [0.3.0]\n\n- Without a date.\n",
        CHANGELOG + "\n## [0.3.0] - 2027-02-01\n\n",
        CHANGELOG + "\n## [0x3.0] - 2027-02-01\n\n- Another version.\n",
    ],
    ids=["absent", "undated", "empty", "another"],
)
def test_a_version_without_dated_notes_is_refused(release, changelog):
    with pytest.raises(SystemExit, match=r"CHANGELOG.md has no notes on 0\.3\.0"):
        release.notes(changelog, "0.3.0")


def test_the_changelog_has_notes_on_the_manifests_version(release):
    text = release.CHANGELOG.read_text(encoding="utf-8")
    assert "### Added" in release.notes(text, release.extension.manifest()["version"])


def test_a_tree_that_differs_from_its_commit_is_refused(release, tmp_path):
    run = lambda *words: subprocess.run(["git", *words], cwd=tmp_path, check=True, capture_output=True)  # noqa: E731
    run("init")
    (tmp_path / "kept").write_text("1")
    run("add", "kept")
    run("-c", "user.name=A", "-c", "user.email=a@b.c", "commit", "-m", "One")
    release.check_committed(tmp_path)
    (tmp_path / "kept").write_text("2")
    (tmp_path / "new").touch()
    with pytest.raises(SystemExit, match="kept, new"):
        release.check_committed(tmp_path)


def test_a_tree_that_is_no_checkout_is_refused(release, tmp_path, monkeypatch):
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    with pytest.raises(SystemExit, match="is no git checkout .*; clone the repository and run this there"):
        release.check_committed(tmp_path)


def test_git_that_is_missing_is_named(release, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(SystemExit, match="git is not installed here"):
        release.check_committed(tmp_path)


def test_nothing_is_built_for_a_version_without_notes(release, tmp_path, monkeypatch):
    (tmp_path / "CHANGELOG.md").write_text("# Changelog\n", encoding="utf-8")
    monkeypatch.setattr(release, "CHANGELOG", tmp_path / "CHANGELOG.md")
    monkeypatch.setattr(sys, "argv", ["release.py", str(tmp_path / "dist")])
    with pytest.raises(SystemExit, match="has no notes"):
        release.main()
    assert not (tmp_path / "dist").exists()


def test_sha256sum_accepts_the_checksums(release, tmp_path):
    paths = [tmp_path / name for name in ("b.zip", "a.zip")]
    for path in paths:
        path.write_bytes(path.name.encode())
    (tmp_path / "SHA256SUMS").write_text(release.checksums(paths))
    check = ["sha256sum", "--check", "--strict", "SHA256SUMS"]
    said = subprocess.run(check, cwd=tmp_path, capture_output=True, text=True)
    assert (said.returncode, said.stdout) == (0, "a.zip: OK\nb.zip: OK\n")
