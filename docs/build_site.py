"""Builds the documentation site: ``python docs/build_site.py SITE``.

Writes the pages of this version to ``SITE/<version>/``. Beside them are ``versions.js``, from which the pages
of all versions fill their switch, and ``index.html``, which leads to the newest version. Folders of other
versions stay: a run in a checkout of each version makes a site with all of them. The site is static and loads
nothing from elsewhere.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import xbus

DOCS = Path(__file__).resolve().parent
VERSION = re.compile(r"(\d+)\.(\d+)\.(\d+)(.*)")


def versions(site: Path) -> list[str]:
    """Returns the versions that a site has, the newest first. A release is newer than its candidates."""
    folders = (path.parent.name for path in site.glob("*/index.html"))
    found = [match for folder in folders if (match := VERSION.fullmatch(folder))]
    found.sort(
        key=lambda match: (*map(int, match.groups()[:3]), not match[4], match[4]), reverse=True
    )
    return [match[0] for match in found]


def write_index(site: Path) -> None:
    """Writes the list of versions, and the page that leads to the newest one."""
    found = versions(site)
    (site / "versions.js").write_text(f"window.XBUS_VERSIONS = {json.dumps(found)};\n", "utf-8")
    target = f"{found[0]}/index.html"
    (site / "index.html").write_text(
        '<!doctype html>\n<meta charset="utf-8">\n<title>xbus</title>\n'
        f'<meta http-equiv="refresh" content="0; url={target}">\n'
        f'<a href="{target}">xbus {found[0]}</a>\n',
        "utf-8",
    )


def main() -> None:
    parser = argparse.ArgumentParser(description="Builds the documentation site.")
    parser.add_argument("site", type=Path, metavar="SITE", help="folder of all versions")
    site: Path = parser.parse_args().site
    site.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=site, prefix=".building-") as name:
        pages = Path(name) / "html"
        trees = Path(name) / "trees"
        command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html"]
        subprocess.run([*command, "-d", trees, DOCS, pages], check=True)  # noqa: S603
        target = site / xbus.__version__
        shutil.rmtree(target, ignore_errors=True)
        pages.rename(target)
    write_index(site)
    print(f"{site}: {', '.join(versions(site))}")


if __name__ == "__main__":
    main()
