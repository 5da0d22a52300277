"""``xbus doctor``: checks of the installation and the serial ports."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from xbus.cli.printing import align, bold, print_json, print_line, print_table

if TYPE_CHECKING:
    from xbus.doctor import Examination
    from xbus.doctor.libraries import Library
    from xbus.doctor.ports import PortState

__all__ = ["doctor"]


@click.command(epilog="Example: xbus doctor --json > doctor.json")
@click.option("--json", "as_json", is_flag=True, help="Print JSON, for a bug report.")
@click.option(
    "--udev-rules",
    is_flag=True,
    help="Print udev rules for Linux, which give users access to Xsens devices, keep ModemManager away and"
    " set latency timers.",
)
def doctor(as_json: bool, udev_rules: bool) -> None:
    """Checks the installation and the serial ports.

    Checks versions and libraries, permissions, other programs that use a port, ModemManager, and the latency
    timers of adapters. A remedy follows each warning and each problem. It opens no port and needs no device.
    The exit status is 1 if there is a problem.
    """
    from xbus.doctor import UDEV_RULES, examine

    if udev_rules:
        print_line(UDEV_RULES.read_text("utf-8").rstrip())
        return
    found = examine()
    if as_json:
        print_json(_as_json(found))
    else:
        _print_facts(found)
        _print_findings(found)
    if found.verdict == "problem":
        raise click.exceptions.Exit(1)


def _as_json(found: Examination) -> dict[str, Any]:
    return {
        "verdict": found.verdict,
        "xbus": found.xbus,
        "python": found.python,
        "system": found.system,
        "libraries": [library._asdict() for library in found.libraries],
        "extras": {
            extra: [library._asdict() for library in libraries]
            for extra, libraries in found.extras.items()
        },
        "ports": [_port_as_json(state) for state in found.ports],
        "modem_manager": found.modem_manager,
        "findings": [finding._asdict() for finding in found.findings],
    }


def _port_as_json(state: PortState) -> dict[str, Any]:
    from xbus.cli.ports import port_as_json

    users = [{"process": number, "program": program} for number, program in state.users]
    return {
        **port_as_json(state.port),
        **state._asdict(),
        "port": state.port.device,
        "users": users,
    }


def _print_facts(found: Examination) -> None:
    python, system = found.python, found.system
    about = [system[key] for key in ("system", "release", "machine", "distribution", "libc")]
    rows = [
        ("xbus", f"{found.xbus['core']} in {found.xbus['folder']}"),
        ("Python", f"{python['implementation']} {python['version']}, {python['bits']} bits"),
        ("system", ", ".join(text for text in about if text)),
        ("libraries", _describe(found.libraries)),
    ]
    print_line("\n".join(align([row for row in rows if row[1]])))
    if found.extras:
        print_line("")
        print_table(
            ["extra", "libraries"],
            [[extra, _describe_extra(extra, found.extras[extra])] for extra in found.extras],
            optional=(),
        )
    if found.ports:
        print_line("")
        print_table(
            ["port", "Xsens", "may be opened", "latency/ms", "description"],
            [_port_cells(state) for state in found.ports],
            optional=(),
        )
    print_line("")


def _describe(libraries: list[Library]) -> str:
    return ", ".join(f"{library.name} {library.version or 'missing'}" for library in libraries)


def _describe_extra(extra: str, libraries: list[Library]) -> str:
    """Returns the versions of the libraries of an extra, or the command that installs it."""
    from xbus.doctor.machine import DISTRIBUTION

    if all(library.version for library in libraries):
        return _describe(libraries)
    return f'not installed: pip install "{DISTRIBUTION}[{extra}]"'


def _port_cells(state: PortState) -> list[str]:
    timer = "" if state.latency_timer is None else str(state.latency_timer)
    may = {True: "yes", False: "no", None: ""}[state.may_use]
    return [
        state.port.device,
        "yes" if state.port.likely else "",
        may,
        timer,
        state.port.description,
    ]


def _print_findings(found: Examination) -> None:
    for finding in found.findings:
        verdict = f"{finding.verdict:<8}"
        print_line(f"{verdict if finding.verdict == 'ok' else bold(verdict)} {finding.message}")
        if finding.remedy is not None:
            print_line(f"{'':<8} {finding.remedy}")
