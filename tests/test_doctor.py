"""The checks of ``xbus doctor``, on machines made of files in a folder."""

from __future__ import annotations

import dataclasses
import json
import os
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from test_cli import run
from xbus._core import __version__
from xbus.device import Port
from xbus.doctor import UDEV_RULES, Finding, Machine, examine
from xbus.doctor.libraries import DEVELOPMENT, Library, as_python_writes, extras
from xbus.doctor.usb import INSTALL_RULES

ROOT = Path(__file__).parents[1]
REQUIREMENTS = [
    "numpy>=1.26",
    'pyarrow>=15; extra == "arrow"',
    "dask[dataframe,distributed]>=2025.1 ; extra == 'dask'",
    "pyarrow>=15 ; extra == 'dask'",
    'pytest>=8 ; extra == "test"',
]
VERSIONS = {"xbus-mti": as_python_writes(__version__), "numpy": "2.4.0"}
USB0 = Port("/dev/ttyUSB0", "Xsens USB converter", True, "XSU7")
#: A group of files that this process may create.
GROUP = 20 if hasattr(os, "geteuid") and os.geteuid() == 0 else getattr(os, "getgid", int)()


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    """Returns a Linux machine on which all is well, with no port."""
    put(tmp_path, "etc/group", f"root:x:0:\ndialout:x:{GROUP}:eve,ann\n")
    put(tmp_path, "etc/os-release", 'NAME="Debian"\nPRETTY_NAME="Debian GNU/Linux 12 (bookworm)"\n')
    put(tmp_path, "proc/1/comm", "systemd\n")
    return Machine(
        root=tmp_path,
        find_ports=list,
        may_use=lambda _: True,
        user=lambda: "bob",
        version=VERSIONS.get,
        requirements=lambda: REQUIREMENTS,
        providers=lambda: ["xbus-mti"],
    )


def put(root: Path, path: str, text: str = "") -> Path:
    """Writes a file of the machine."""
    file = root / path
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text)
    return file


def plug_in(
    machine: Machine, *, group: int = GROUP, mode: int = 0o660, timer: str = "1"
) -> Machine:
    """Adds a converter with a driver and a port."""
    put(machine.root, "sys/bus/usb/devices/1-2/idVendor", "0403\n")
    put(machine.root, "sys/bus/usb/devices/1-2/idProduct", "d38b\n")
    put(machine.root, "sys/bus/usb/devices/1-2/1-2:1.0/ttyUSB0/port_number", "0\n")
    put(machine.root, "sys/bus/usb-serial/devices/ttyUSB0/latency_timer", f"{timer}\n")
    port = put(machine.root, "dev/ttyUSB0")
    os.chown(port, -1, GROUP)
    port.chmod(mode)
    return dataclasses.replace(machine, find_ports=lambda: [USB0])


def found(machine: Machine, check: str) -> list[Finding]:
    return [finding for finding in examine(machine).findings if finding.check == check]


def only(machine: Machine, check: str) -> Finding:
    (finding,) = found(machine, check)
    return finding


# The installation


def test_all_is_well(machine: Machine) -> None:
    examination = examine(plug_in(machine))
    assert {finding.verdict for finding in examination.findings} == {"ok"}
    assert {finding.remedy for finding in examination.findings} == {None}
    assert examination.verdict == "ok"
    assert examination.xbus["core"] == __version__
    assert examination.system["distribution"] == "Debian GNU/Linux 12 (bookworm)"
    assert [library.name for library in examination.libraries] == ["numpy"]
    assert list(examination.extras) == ["arrow", "dask"]


def test_a_stale_extension_module(machine: Machine) -> None:
    stale = dataclasses.replace(machine, version={**VERSIONS, "xbus-mti": "99.0"}.get)
    finding = only(stale, "installation")
    assert finding.verdict == "problem"
    assert (
        finding.message
        == f"the installed package is 99.0, but its extension module is {__version__}"
    )
    assert finding.remedy == "pip install --force-reinstall xbus-mti"


@pytest.mark.parametrize(
    ("core", "installed"),
    [("0.2.0-rc.1", "0.2.0rc1"), ("0.2.0-alpha.2", "0.2.0a2"), ("0.2.0-beta.3", "0.2.0b3")],
)
def test_a_version_before_a_release(
    core: str, installed: str, machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("xbus.doctor.libraries.__version__", core)
    for version, verdict in ((installed, "ok"), ("0.2.0", "problem")):
        changed = dataclasses.replace(machine, version={**VERSIONS, "xbus-mti": version}.get)
        assert only(changed, "installation").verdict == verdict


def test_a_checkout_without_metadata(machine: Machine) -> None:
    checkout = dataclasses.replace(machine, version=lambda _: None, requirements=lambda: None)
    assert only(checkout, "installation").verdict == "warning"
    assert found(checkout, "libraries") == []
    assert examine(checkout).extras == {}


def test_another_distribution_with_the_same_package(machine: Machine) -> None:
    finding = only(
        dataclasses.replace(machine, providers=lambda: ["xbus", "xbus-mti"]), "installation"
    )
    assert finding.verdict == "problem"
    assert finding.remedy is not None
    assert finding.remedy.startswith("pip uninstall xbus, then")


@pytest.mark.parametrize(
    ("installed", "verdict", "message"),
    [
        ({"numpy": "1.26"}, "ok", "all installed libraries are recent enough"),
        ({"numpy": "1.26.0rc1"}, "ok", "all installed libraries are recent enough"),
        ({"numpy": "1.9"}, "problem", "numpy is 1.9; xbus needs 1.26 or later"),
        ({"numpy": None}, "problem", "numpy is not installed; xbus needs 1.26 or later"),
        ({"pyarrow": "15.0.0"}, "ok", "all installed libraries are recent enough"),
        ({"pyarrow": None}, "ok", "all installed libraries are recent enough"),
        (
            {"dask": "2024.12.1"},
            "warning",
            "dask is 2024.12.1; the extra dask needs 2025.1 or later",
        ),
        ({"pytest": "7.0"}, "ok", "all installed libraries are recent enough"),
    ],
)
def test_libraries(
    installed: dict[str, str | None], verdict: str, message: str, machine: Machine
) -> None:
    finding = only(dataclasses.replace(machine, version={**VERSIONS, **installed}.get), "libraries")
    assert (finding.verdict, finding.message) == (verdict, message)
    assert (finding.remedy is None) is (verdict == "ok")


def test_the_extras_are_those_of_the_project(machine: Machine) -> None:
    """The requirements in metadata are read as pyproject.toml has them, and install.md lists them."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    optional: dict[str, list[str]] = project["optional-dependencies"]
    requirements = [
        f'{requirement}; extra == "{extra}"'
        for extra in optional
        for requirement in optional[extra]
    ]
    listed = extras(dataclasses.replace(machine, requirements=lambda: requirements))
    assert listed.keys() == optional.keys() - DEVELOPMENT
    for extra, libraries in listed.items():
        assert len(libraries) == len(optional[extra])
    page = (ROOT / "docs" / "install.md").read_text("utf-8")
    assert not [extra for extra in listed if f"\n| `{extra}` |" not in page]


def test_a_version_is_compared_by_its_numbers() -> None:
    assert Library("x", "1.9", "1.10").is_enough
    assert Library("x", "1.10.0", "1.10").is_enough
    assert not Library("x", "1.10.1", "1.10").is_enough
    assert not Library("x", "1", "unknown").is_enough


# USB devices and ports

needs_files_of_linux = pytest.mark.skipif(os.name == "nt", reason="files without groups")


def test_no_port(machine: Machine) -> None:
    finding = only(machine, "ports")
    assert (finding.verdict, finding.message) == ("warning", "no serial port was found")
    assert finding.remedy is not None
    assert "sim:MTi-630" in finding.remedy


def test_no_port_in_wsl(machine: Machine) -> None:
    put(machine.root, "proc/version", "Linux version 6.6.87.2-microsoft-standard-WSL2\n")
    assert "usbipd attach --wsl" in str(only(machine, "ports").remedy)


@needs_files_of_linux
@pytest.mark.parametrize(
    ("user", "mode", "remedy"),
    [
        ("bob", 0o660, 'sudo usermod -aG dialout "$USER", then log out and in again'),
        ("ann", 0o660, "log out and in again: the group dialout counts from then on"),
        ("bob", 0o600, INSTALL_RULES),
    ],
)
def test_permission(user: str, mode: int, remedy: str, machine: Machine) -> None:
    denied = dataclasses.replace(
        plug_in(machine, mode=mode), may_use=lambda _: False, user=lambda: user
    )
    finding = only(denied, "ports")
    assert finding.verdict == "problem"
    assert finding.message == f"{user} may not open /dev/ttyUSB0"
    assert finding.remedy == remedy


@needs_files_of_linux
def test_the_port_is_asked_for_its_permission(machine: Machine) -> None:
    asked: list[Path] = []

    def may_use(path: Path) -> bool:
        asked.append(path)
        return True

    (state,) = examine(dataclasses.replace(plug_in(machine), may_use=may_use)).ports
    assert asked == [machine.root / "dev/ttyUSB0"]
    assert (state.may_use, state.group, state.latency_timer, state.users) == (
        True,
        "dialout",
        1,
        [],
    )


@needs_files_of_linux
def test_another_program_uses_the_port(machine: Machine) -> None:
    put(machine.root, "proc/77/comm", "screen\n")
    put(machine.root, f"proc/{os.getpid()}/comm", "python\n")
    for process in (77, os.getpid()):
        (machine.root / f"proc/{process}/fd").mkdir()
        (machine.root / f"proc/{process}/fd/3").symlink_to("/dev/ttyUSB0")
        (machine.root / f"proc/{process}/fd/4").symlink_to("/dev/null")
    finding = only(plug_in(machine), "ports")
    assert finding.verdict == "problem"
    assert finding.message == "screen, process 77, has /dev/ttyUSB0 open"
    assert finding.remedy == "close screen"


@needs_files_of_linux
@pytest.mark.parametrize(("timer", "verdict"), [("1", "ok"), ("16", "warning"), ("", "ok")])
def test_latency_timer(timer: str, verdict: str, machine: Machine) -> None:
    finding = only(plug_in(machine, timer=timer), "ports")
    assert finding.verdict == verdict
    assert ("16 ms" in finding.message) is (verdict == "warning")


def test_a_port_of_windows(machine: Machine) -> None:
    windows = dataclasses.replace(machine, find_ports=lambda: [Port("COM3", "MTi", True, None)])
    assert only(windows, "ports") == Finding("ports", "ok", "COM3 is ready to use")
    assert examine(windows).ports[0].may_use is None


@needs_files_of_linux
def test_a_device_without_a_driver(machine: Machine) -> None:
    put(machine.root, "sys/bus/usb/devices/1-3/idVendor", "2639\n")
    put(machine.root, "sys/bus/usb/devices/1-3/idProduct", "0017\n")
    put(machine.root, "sys/bus/usb/devices/1-4/idVendor", "8087\n")
    put(machine.root, "sys/bus/usb/devices/1-4/idProduct", "0002\n")
    (machine.root / "sys/bus/usb/devices/usb1").mkdir()
    finding = only(plug_in(machine), "driver")
    assert finding.verdict == "problem"
    assert "2639:0017" in finding.message
    assert str(finding.remedy).startswith("sudo modprobe xsens_mt")


@needs_files_of_linux
def test_a_container_without_the_port(machine: Machine) -> None:
    (plug_in(machine).root / "dev/ttyUSB0").unlink()
    finding = only(machine, "driver")
    assert finding.verdict == "problem"
    assert finding.remedy == "start the container with --device /dev/ttyUSB0"


@pytest.mark.parametrize(
    ("rules", "verdict"),
    [
        ("", "warning"),
        ('ATTR{idVendor}=="1546", ENV{ID_MM_DEVICE_IGNORE}="1"', "warning"),
        (UDEV_RULES.read_text("utf-8"), "ok"),
    ],
)
def test_modem_manager(rules: str, verdict: str, machine: Machine) -> None:
    assert only(machine, "ModemManager").message == "ModemManager does not run"
    put(machine.root, "proc/512/comm", "ModemManager\n")
    put(machine.root, "etc/udev/rules.d/70-xsens.rules", rules)
    finding = only(machine, "ModemManager")
    assert finding.verdict == verdict
    assert finding.remedy == (INSTALL_RULES if verdict == "warning" else None)
    assert examine(machine).modem_manager is True


def test_a_system_without_proc(machine: Machine) -> None:
    (machine.root / "proc/1/comm").unlink()
    assert found(machine, "ModemManager") == []
    assert examine(machine).modem_manager is None


# The command


@pytest.fixture
def here(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> Callable[[Machine], None]:
    """Makes `xbus doctor` examine another machine."""

    def put_here(machine: Machine) -> None:
        monkeypatch.setattr("xbus.doctor.examination.Machine", lambda: machine)

    put_here(machine)
    return put_here


@needs_files_of_linux
def test_the_text(here: Callable[[Machine], None], machine: Machine) -> None:
    here(dataclasses.replace(plug_in(machine), may_use=lambda _: False))
    result = run("doctor")
    assert result.exit_code == 1
    assert f"xbus       {__version__} in " in result.stdout
    table = result.stdout[result.stdout.index("extra  ") :]
    assert table == (
        "extra  libraries\n"
        'arrow  not installed: pip install "xbus-mti[arrow]"\n'
        'dask   not installed: pip install "xbus-mti[dask]"\n'
        "\n"
        "port          Xsens  may be opened  latency/ms  description\n"
        "/dev/ttyUSB0  yes    no             1           Xsens USB converter\n"
        "\n"
        "ok       package and extension module have the same version\n"
        "ok       all installed libraries are recent enough\n"
        "problem  bob may not open /dev/ttyUSB0\n"
        '         sudo usermod -aG dialout "$USER", then log out and in again\n'
        "ok       ModemManager does not run\n"
    )


@needs_files_of_linux
def test_the_json(here: Callable[[Machine], None], machine: Machine) -> None:
    here(plug_in(machine))
    result = run("doctor", "--json")
    assert result.exit_code == 0
    facts: dict[str, Any] = json.loads(result.stdout)
    assert facts["verdict"] == "ok"
    assert facts["ports"] == [
        {
            "port": "/dev/ttyUSB0",
            "likely": True,
            "description": "Xsens USB converter",
            "serial_number": "XSU7",
            "may_use": True,
            "group": "dialout",
            "latency_timer": 1,
            "users": [],
        }
    ]
    assert facts["extras"]["arrow"] == [{"name": "pyarrow", "needs": "15", "version": None}]
    assert facts["findings"][0] == {
        "check": "installation",
        "verdict": "ok",
        "message": "package and extension module have the same version",
        "remedy": None,
    }


def test_this_machine() -> None:
    """The command runs on the machine of the tests, whatever it finds."""
    result = run("doctor", "--json")
    facts = json.loads(result.stdout)
    assert result.exit_code == (facts["verdict"] == "problem")
    assert facts["xbus"]["core"] == __version__
    assert str(Path.home()) not in result.stdout


def test_the_udev_rules_are_those_of_the_documentation() -> None:
    result = run("doctor", "--udev-rules")
    assert result.stdout == UDEV_RULES.read_text("utf-8")
    assert result.stdout in (ROOT / "docs" / "howto" / "hardware.md").read_text("utf-8")
