"""The version, which Cargo.toml alone sets, and its section of the changelog.

python .ci/version.py                  prints the version
python .ci/version.py --changes        prints its section of CHANGELOG.md
python .ci/version.py --release TAG    fails unless TAG is the version, and all is ready to publish it
"""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
HEADING = re.compile(r"^## (\S+) \((unreleased|\d{4}-\d\d-\d\d)\)$", re.MULTILINE)


def version() -> str:
    """Returns the version."""
    package = tomllib.loads((ROOT / "Cargo.toml").read_text("utf-8"))["package"]
    return str(package["version"])


def sections(text: str) -> dict[str, tuple[str, str]]:
    """Returns date and text of each version in a changelog, the newest first."""
    _, *parts = HEADING.split(text)
    names, dates, texts = parts[::3], parts[1::3], parts[2::3]
    return {
        name: (date, text.strip()) for name, date, text in zip(names, dates, texts, strict=True)
    }


def mistakes(tag: str, version: str, changelog: str, citation: str | None) -> list[str]:
    """Returns what is not ready for a release with a tag."""
    found = []
    if tag != f"v{version}":
        found.append(f"the tag is {tag}, and Cargo.toml has {version}")
    date, _ = sections(changelog).get(version, ("", ""))
    if not date:
        found.append(f"CHANGELOG.md has no section {version}")
    elif date == "unreleased":
        found.append(f"CHANGELOG.md says that {version} is unreleased; write the date")
    if (
        citation is not None
        and re.search(rf"^version: \"?{re.escape(version)}\"?$", citation, re.M) is None
    ):
        found.append(f"CITATION.cff has another version than {version}")
    return found


def main() -> None:
    changelog = (ROOT / "CHANGELOG.md").read_text("utf-8")
    match sys.argv[1:]:
        case []:
            print(version())
        case ["--changes"]:
            print(sections(changelog)[version()][1])
        case ["--release", tag]:
            file = ROOT / "CITATION.cff"
            citation = file.read_text("utf-8") if file.exists() else None
            if found := mistakes(tag, version(), changelog, citation):
                sys.exit("\n".join(found))
            print(f"{tag} is ready")
        case _:
            sys.exit(__doc__)


if __name__ == "__main__":
    main()
