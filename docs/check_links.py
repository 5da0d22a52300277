"""Checks the links inside built pages, offline: ``python docs/check_links.py docs/_build/html``.

Every link to a page, an anchor, a picture or a script must lead to something in the folder, and nothing may
be loaded from elsewhere. ``make linkcheck`` checks links to other sites, which needs a network.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

#: Attributes that make a browser load something, and the tags on which they do.
LOADED = {
    ("script", "src"),
    ("img", "src"),
    ("link", "href"),
    ("iframe", "src"),
    ("object", "data"),
}
#: Beside the folder of a version; docs/build_site.py writes it.
OUTSIDE = "versions.js"


class Page(HTMLParser):
    """The anchors and links of a page: each link with True if the browser loads its target by itself."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[tuple[str, bool]] = []
        self.feed(path.read_text("utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name == "id" and value:
                self.anchors.add(value)
            elif value and ((tag, name) in LOADED or name == "href"):
                self.links.append((value, (tag, name) in LOADED))


def broken_links(folder: Path) -> Iterator[str]:
    """Yields a line for each link that leads nowhere, and for each file that is loaded from elsewhere."""
    pages = {path: Page(path) for path in sorted(folder.rglob("*.html"))}
    for path, page in pages.items():
        for link, is_loaded in page.links:
            where = f"{path.relative_to(folder)}: {link}"
            url = urlsplit(link)
            if url.scheme or url.netloc:
                if is_loaded and url.scheme != "data":
                    yield f"{where} is loaded from elsewhere"
                continue
            target = (path.parent / unquote(url.path)).resolve() if url.path else path
            if target == folder.parent.resolve() / OUTSIDE:
                continue
            if not target.is_file():
                yield f"{where} leads to no file"
            elif (
                url.fragment
                and target in pages
                and unquote(url.fragment) not in pages[target].anchors
            ):
                yield f"{where} leads to no anchor"


def main() -> None:
    folder = Path(sys.argv[1]).resolve()
    faults = list(broken_links(folder))
    print(*faults, sep="\n", end="\n" if faults else "")
    print(f"{len(list(folder.rglob('*.html')))} pages, {len(faults)} broken links")
    sys.exit(bool(faults))


if __name__ == "__main__":
    main()
