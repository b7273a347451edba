"""Builds the guide as a site that needs no network: `make site`.

Usage: python scripts/guide/build.py FOLDER
Broken links and pages outside the navigation are errors, and so is a page that loads something from elsewhere.
"""

import argparse
import re
import shutil
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
# Resources that a browser loads without a click, unlike links.
LOADED = re.compile(
    r"""<(?:script|img|iframe|source|video)\b[^>]*?\bsrc=["']?(?:https?:)?//[^\s"'>]+"""
    r"""|<link\b(?=[^>]*\brel=["']?(?:stylesheet|preload|icon|preconnect))[^>]*?\bhref=["']?(?:https?:)?//[^\s"'>]+"""
    r"""|url\(["']?(?:https?:)?//[^)"']+|@import\s+["'](?:https?:)?//[^"']+""",
    re.IGNORECASE,
)


def loads_from_elsewhere(folder: Path) -> list[str]:
    """Return "FILE: resource" for every page and style sheet that loads something from the network."""
    files = sorted(path for path in folder.rglob("*") if path.suffix in (".html", ".css"))
    return [
        f"{path.relative_to(folder)}: {match[0]}"
        for path in files
        for match in LOADED.finditer(path.read_text(encoding="utf-8"))
    ]


def main() -> int:
    """Build into the folder named on the command line; return Sphinx's exit code, or 1 where a page needs a network."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    shutil.rmtree(folder / "html", ignore_errors=True)
    options = ["-q", "--fail-on-warning", "--keep-going", "-b", "html", "-c", HERE, "-d", folder / "doctrees"]
    code = subprocess.run([sys.executable, "-m", "sphinx", *options, ROOT, folder / "html"]).returncode
    if code:
        return code
    if outside := loads_from_elsewhere(folder / "html"):
        print("pages that need a network:", *outside, sep="\n", file=sys.stderr)
        return 1
    pages = len(list((folder / "html").rglob("*.html")))
    print(f"{folder / 'html' / 'index.html'}  {pages} pages")
    return 0


if __name__ == "__main__":
    sys.exit(main())
