"""Makes a release: the zips of every system, their SHA-256 checksums, and the notes that the changelog has for it.

Usage: python scripts/release.py FOLDER
The version is the manifest's. Without a dated section of it in CHANGELOG.md, or with changes that are not committed,
nothing is built.
"""

import argparse
import hashlib
import re
from pathlib import Path

import extension

CHANGELOG = extension.ROOT / "CHANGELOG.md"
CHECKSUMS = "SHA256SUMS"


def notes(changelog: str, version: str) -> str:
    """Return a version's section of a changelog, without its heading. Raises SystemExit if there is none."""
    heading = rf"^## \[{re.escape(version)}\] - \d{{4}}-\d{{2}}-\d{{2}}$\n(.*?)(?=^## |\Z)"
    section = re.search(heading, changelog, re.MULTILINE | re.DOTALL)
    text = section[1].strip() if section else ""
    if not text:
        raise SystemExit(
            f"CHANGELOG.md has no notes on {version}; write them under the heading `## [{version}] - YYYY-MM-DD`"
        )
    return f"{text}\n"


def check_committed(root: Path) -> None:
    """Check that all files are committed. Raises SystemExit, naming those that are not, or if there is no checkout."""
    changed = extension.git("status", "--porcelain", root=root).splitlines()
    if changed:
        names = ", ".join(line[3:] for line in changed[:5]) + (", …" if len(changed) > 5 else "")
        raise SystemExit(f"a release is made from a commit; commit or remove these files: {names}")


def checksums(packages: list[Path]) -> str:
    """Return the lines for `sha256sum --check`, run beside the packages."""
    return "".join(f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n" for path in sorted(packages))


def main() -> None:
    """Make the release in the folder of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    version = extension.manifest()["version"]
    text = notes(CHANGELOG.read_text(encoding="utf-8"), version)
    check_committed(extension.ROOT)
    packages = [package for package, _ in extension.build_all(folder).values()]
    page = folder / f"{extension.manifest()['id']}-{version}.md"
    page.write_text(text, encoding="utf-8")
    (folder / CHECKSUMS).write_text(checksums(packages), encoding="utf-8")
    for path in (*packages, folder / CHECKSUMS, page):
        print(f"{path}  {path.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
