"""Writes THIRD-PARTY.txt, the licences of what wheels contain: ``python tests/make_third_party.py``.

A wheel contains crates as machine code, and scripts of pages, so their licences belong into it. Needs cargo,
which downloads crates that are missing.
"""

from __future__ import annotations

import json
import re
import subprocess
from collections import defaultdict
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
NOTICES = ROOT / "THIRD-PARTY.txt"
#: One target for each set of crates: platforms differ, processors and C libraries do not.
TARGETS = ("x86_64-unknown-linux-gnu", "aarch64-apple-darwin", "x86_64-pc-windows-msvc")
#: Licences of C code that a crate contains and compiles.
BUNDLED = {"lz4-sys": ("liblz4/lib/LICENSE",), "zstd-sys": ("zstd/LICENSE",)}
#: The comment at the start of a script: copyright holder, name and version.
SCRIPT_HEAD = re.compile(
    r"Copyright \(c\) (?P<holder>.*)\n.*\(MIT Licensed\)[^/]*?"
    r"(?P<name>\w+)\.js[\s\S]*?\(v(?P<version>[\d.]+)\)"
)
LICENCE_FILE = re.compile(r"(licen[cs]e|copying|notice|unlicense)[-._\w]*", re.IGNORECASE)

HEADER = """\
The extension module of xbus contains the crates below and the standard library of Rust, which is under the
MIT licence: Copyright (c) The Rust Project Contributors. Where a crate offers a choice of licences, xbus uses
it under the first one of MIT, BSD and Apache-2.0 that the choice has. The pages of xbus contain the scripts
below. xbus itself is under the MIT licence in LICENSE. python tests/make_third_party.py writes this file.
"""

MIT = """\
MIT License

Copyright (c) {holder}

Permission is hereby granted, free of charge, to any person obtaining a copy
of this software and associated documentation files (the "Software"), to deal
in the Software without restriction, including without limitation the rights
to use, copy, modify, merge, publish, distribute, sublicense, and/or sell
copies of the Software, and to permit persons to whom the Software is
furnished to do so, subject to the following conditions:

The above copyright notice and this permission notice shall be included in all
copies or substantial portions of the Software.

THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR
IMPLIED, INCLUDING BUT NOT LIMITED TO THE WARRANTIES OF MERCHANTABILITY,
FITNESS FOR A PARTICULAR PURPOSE AND NONINFRINGEMENT. IN NO EVENT SHALL THE
AUTHORS OR COPYRIGHT HOLDERS BE LIABLE FOR ANY CLAIM, DAMAGES OR OTHER
LIABILITY, WHETHER IN AN ACTION OF CONTRACT, TORT OR OTHERWISE, ARISING FROM,
OUT OF OR IN CONNECTION WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE
SOFTWARE.
"""

Crate = dict[str, Any]


def scripts() -> list[tuple[str, str]]:
    """Returns title and copyright holder of the MIT-licensed scripts of other people in the package.

    Both are in the comment at the start of the script.
    """
    found = []
    for path in sorted((ROOT / "python").rglob("*.js")):
        head = path.read_text("utf-8")[:1000]
        if "Copyright" not in head:  # ours
            continue
        if not (licence := SCRIPT_HEAD.search(head)):
            raise ValueError(f"{path} does not begin with its licence as SCRIPT_HEAD expects it")
        holder, name, version = licence.groups()
        found.append((f"{name} {version}", holder))
    return found


def crates() -> list[Crate]:
    """Returns the crates that are linked into the extension, on any platform, by name."""
    found: dict[str, Crate] = {}
    for target in TARGETS:
        command = ["cargo", "metadata", "--locked", "--format-version=1", "--features=python"]
        done = subprocess.run(  # noqa: S603 - our own command
            [*command, f"--filter-platform={target}"], cwd=ROOT, capture_output=True, check=True
        )
        metadata = json.loads(done.stdout)
        packages = {package["id"]: package for package in metadata["packages"]}
        nodes = {node["id"]: node for node in metadata["resolve"]["nodes"]}
        root = metadata["resolve"]["root"]
        waiting, seen = [root], set()
        while waiting:
            crate = waiting.pop()
            kinds = {kind for part in packages[crate]["targets"] for kind in part["kind"]}
            if crate in seen or "proc-macro" in kinds:  # runs in the compiler
                continue
            seen.add(crate)
            waiting += [
                dependency["pkg"]
                for dependency in nodes[crate]["deps"]
                if any(kind["kind"] is None for kind in dependency["dep_kinds"])
            ]
        found |= {crate: packages[crate] for crate in seen - {root}}
    return sorted(found.values(), key=lambda crate: (crate["name"], crate["version"]))


def chosen(licence: str) -> str:
    """Returns the part of a licence expression under which xbus uses a crate."""
    if " AND " in licence:
        return licence
    choices = re.split(r" OR |/", licence)
    for wanted in ("MIT", "BSD", "Apache-2.0"):
        for choice in choices:
            if choice.startswith(wanted):
                return choice
    raise ValueError(f"no known licence in {licence!r}")


def files(crate: Crate, licence: str) -> list[Path]:
    """Returns the licences and notices of a crate that belong to the chosen licence."""
    folder = Path(crate["manifest_path"]).parent
    every = sorted(path for path in folder.iterdir() if LICENCE_FILE.fullmatch(path.name))
    if " AND " not in licence:
        others = {"MIT", "APACHE", "BSD", "ZLIB", "UNLICENSE", "COPYING"} - {
            licence.split("-")[0].upper()
        }
        own = [path for path in every if not any(other in path.name.upper() for other in others)]
        every = own or every
    return every + [folder / name for name in BUNDLED.get(crate["name"], ())]


def text() -> str:
    """Returns the content of THIRD-PARTY.txt: a table of the crates, then each text with its crates."""
    rows: list[str] = []
    users: dict[str, list[str]] = defaultdict(list)
    apache = ""
    without: list[str] = []
    for crate in crates():
        title = f"{crate['name']} {crate['version']}"
        licence = chosen(crate["license"])
        rows.append(f"{title:<36}{licence}")
        texts = [path.read_text("utf-8") for path in files(crate, licence)]
        if not texts and licence == "MIT":
            holder = f"the authors of {crate['name']}, {crate['repository']}"
            texts = [MIT.format(holder=holder)]
        for content in texts:
            tidy = "\n".join(line.rstrip() for line in content.strip().splitlines())
            users[tidy].append(title)
            if "Apache License" in tidy and "TERMS AND CONDITIONS" in tidy:
                apache = apache or tidy
        if not texts:
            if licence != "Apache-2.0":
                raise ValueError(f"{title} has no file with its licence, {licence}")
            without.append(title)
    users[apache] += without
    for title, holder in scripts():
        rows.append(f"{title:<36}MIT")
        users[MIT.strip().format(holder=holder)].append(title)
    parts = [HEADER, "\n".join(rows) + "\n"]
    parts += [f"{'=' * 80}\n{', '.join(names)}\n\n{content}\n" for content, names in users.items()]
    return "\n".join(parts)


if __name__ == "__main__":
    NOTICES.write_text(text(), "utf-8")
