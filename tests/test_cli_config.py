"""``xbus config``, and ``xbus record --config``."""

from __future__ import annotations

import json
import signal
import tomllib
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import xbus
from test_cli import run, sentence
from test_settings import Stubborn, changed
from xbus import Device, Session, SimulatedDevice, connect
from xbus.protocol.tables import PRODUCTS

PRODUCT_NAMES = [product.name for product in PRODUCTS.values()]


@pytest.fixture
def file(tmp_path: Path) -> Callable[[str], str]:
    """Returns a function that writes a settings file and returns its name."""

    def write(text: str) -> str:
        path = tmp_path / "mti.toml"
        path.write_text(text, "utf-8")
        return str(path)

    return write


@pytest.mark.parametrize("product", PRODUCT_NAMES)
def test_a_dumped_configuration_can_be_applied_after_a_reset(
    product: str, behind: Callable[[SimulatedDevice], str], tmp_path: Path
) -> None:
    sim = SimulatedDevice(product)
    connect(sim).apply(changed(sim.product.number))
    port, path = behind(sim), tmp_path / "mti.toml"
    assert run("config", "dump", port, "-o", str(path)).output == ""
    assert run("config", "dump", port).stdout == path.read_text("utf-8")
    with connect(sim) as device, device.configure():
        device.commands.restore_factory_def()
    planned = run("config", "apply", port, str(path), "--dry-run")
    shown = run("config", "diff", port, str(path))
    done = run("config", "apply", port, str(path))
    assert planned.exit_code == shown.exit_code == done.exit_code == 0
    assert sorted(planned.stdout) == sorted(shown.stdout)
    assert planned.stdout == done.stdout
    assert "- location_id = 0\n+ location_id = 4711\n" in done.stdout
    assert "set and read back" in done.stderr
    assert run("config", "dump", port).stdout == path.read_text("utf-8")
    for command in ("diff", "apply"):
        again = run("config", command, port, str(path))
        assert (again.stdout, again.stderr) == ("", "xbus: no differences\n")


def test_a_dry_run_sets_nothing(
    behind: Callable[[SimulatedDevice], str], file: Callable[[str], str]
) -> None:
    sim = SimulatedDevice("MTi-630")
    result = run("config", "apply", behind(sim), file("location_id = 7"), "--dry-run")
    assert result.stdout == "- location_id = 0\n+ location_id = 7\n"
    assert result.stderr == "xbus: 1 setting would be set\n"
    assert connect(sim).settings().location_id == 0


def test_each_setting_is_read_once(
    monkeypatch: pytest.MonkeyPatch, file: Callable[[str], str]
) -> None:
    sent: list[str] = []
    request = Session.request

    def counted(self: Session, name: str, value: Any = None) -> bytes:
        sent.append(name)
        return request(self, name, value)

    monkeypatch.setattr(Session, "request", counted)
    assert run("config", "apply", "sim:MTi-630", file("location_id = 7")).exit_code == 0
    assert [name for name in sent if not name.startswith("Req")] == [
        "GoToConfig",
        "SetLocationID",
        "GoToMeasurement",
    ]
    requests = Counter(name for name in sent if name.startswith("Req"))
    # The changed setting is read back, and the two rotations have the same request.
    assert {name for name, count in requests.items() if count > 1} == {
        "ReqLocationID",
        "ReqAlignmentRotation",
    }
    assert max(requests.values()) == 2


def test_settings_that_need_a_reset_are_reported(file: Callable[[str], str]) -> None:
    name = file("can_config = { baudrate = 1000000 }")
    result = run("config", "apply", "sim:MTi-630", name)
    assert result.stdout == (
        "- can_config = { baudrate = 250000, enabled = false }\n+ can_config = { baudrate = 1000000 }\n"
    )
    assert result.stderr == (
        "xbus: 1 setting set and read back; ports and CAN change at the next reset\n"
    )


def test_rounded_settings_are_reported(file: Callable[[str], str]) -> None:
    name = file('output_configuration = [{ quantity = "gnss_pvt_data", frequency = 4 }]')
    result = run("config", "apply", "sim:MTi-670", name)
    assert result.stderr.splitlines() == [
        "xbus: the device rounds output_configuration: - the file, + the device",
        "  output_configuration",
        '-   { quantity = "gnss_pvt_data", frequency = 4 },',
        '+   { quantity = "gnss_pvt_data" },',
        "xbus: 1 setting set and read back",
    ]


def test_outputs_beyond_the_baud_rate_are_refused(file: Callable[[str], str]) -> None:
    name = file('output_configuration = [{ quantity = "acceleration", precision = "Float64" }]')
    printed = sentence(run("config", "apply", "sim:MTi-630", name))
    assert f"{name}: line 1, output_configuration: these outputs make about" in printed
    assert run("config", "apply", "sim:MTi-630", name, "--no-line").exit_code == 0


#: Content of the file, or None for no file; and the error message.
BAD: list[tuple[str | bytes | None, str]] = [
    (None, "cannot read FILE: No such file or directory; check the path"),
    (b"\xff", "FILE: byte 0 is not UTF-8; this is not TOML"),
    ("x", "FILE: line 1: expected '=' after a key in a key/value pair; this is not TOML"),
    (
        "\nlocation = 1",
        "FILE: line 2, location: there is no setting of this name; did you mean location_id?",
    ),
    ('location_id = "1"', 'FILE: line 1, location_id: "1" is not a whole number'),
]


@pytest.mark.parametrize("command", ["diff", "apply", "record"])
@pytest.mark.parametrize(("content", "says"), BAD)
def test_bad_files_are_reported_before_the_port_is_opened(
    command: str, content: str | bytes | None, says: str, tmp_path: Path
) -> None:
    path = tmp_path / "mti.toml"
    if content is not None:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    words = ["config", command, "/dev/no-such-port", str(path)]
    if command == "record":
        out = str(tmp_path / "out.mtb")
        words = ["record", "/dev/no-such-port", "-o", out, "--config", str(path)]
    assert sentence(run(*words)) == says.replace("FILE", str(path))


def test_settings_that_the_product_lacks_are_refused(file: Callable[[str], str]) -> None:
    name = file("location_id = 1\n\ngnss_lever_arm = { x = 0, y = 0, z = 1 }\nbaudrate = 9600\n")
    result = run("config", "apply", "sim:MTi-30", name)
    assert (result.exit_code, result.stdout) == (1, "")
    assert result.stderr.splitlines() == [
        f"xbus: {name}: line 3, gnss_lever_arm: the MTi-30 does not have this setting",
        f"xbus: {name}: line 4, baudrate: the baud rate is not changed with the settings; remove this"
        " key; nothing was sent",
    ]


def test_several_devices_get_the_same_settings(
    monkeypatch: pytest.MonkeyPatch, file: Callable[[str], str]
) -> None:
    sims = [SimulatedDevice("MTi-630", device_id=0x80001000 + number) for number in range(4)]
    connect(sims[1]).apply(xbus.Settings(location_id=7))
    there = {f"port{number}": sim for number, sim in enumerate([*sims, SimulatedDevice("MTi-30")])}
    monkeypatch.setattr(
        "xbus.device.connect",
        lambda port, *args, **more: connect(there.get(port, port), *args, **more),
    )
    ports = [*there, "sim:MTi-5"]
    name = file('product = "MTi-630"\nlocation_id = 7\n')
    planned = run("config", "apply", *ports[:3], name, "--dry-run")
    assert planned.exit_code == 0
    assert [row.split("  ")[-1] for row in planned.stdout.splitlines()] == [
        "result",
        "1 setting would be set",
        "no differences",
        "1 setting would be set",
    ]
    result = run("config", "apply", *ports, name)
    assert result.exit_code == 1
    assert result.stderr == (
        f"xbus: 2 of 6 devices do not have the settings: {ports[4]}, sim:MTi-5\n"
    )
    rows = result.stdout.splitlines()
    assert rows[0].split() == ["port", "device", "result"]
    assert rows[1].split(maxsplit=3) == [ports[0], "MTi-630-8A1G6", "0080001000", "1 setting set"]
    assert rows[2].endswith("no differences")
    assert 'the settings are for "MTi-630", and the product of the device is MTi-30' in rows[5]
    assert "no product is called 'MTi-5'" in rows[6]
    assert [connect(sim).settings().location_id for sim in sims] == [7, 7, 7, 7]
    facts = json.loads(run("config", "apply", *ports, name, "--json").stdout)
    assert [row["port"] for row in facts] == ports
    assert [row["problem"] is None for row in facts] == [True, True, True, True, False, False]
    assert facts[0]["device_id"] == "0080001000"


def test_one_of_several_devices_refuses(
    monkeypatch: pytest.MonkeyPatch, file: Callable[[str], str]
) -> None:
    made = [Stubborn("SetLocationID", says_so=True), connect("sim:MTi-630")]
    monkeypatch.setattr("xbus.device.connect", lambda *_, **__: made.pop())
    name = file('location_id = 7\nfilter_profile = "Robust/VRU"')
    result = run("config", "apply", "one", "other", name, "--json")
    assert result.exit_code == 1
    one, other = json.loads(result.stdout)
    assert one["changes"] == ["filter_profile", "location_id"]
    assert other["changes"] == ["filter_profile"]
    assert "not applied: location_id" in other["problem"]


def test_a_port_is_given_once(tmp_path: Path, file: Callable[[str], str]) -> None:
    port, link = tmp_path / "port", tmp_path / "link"
    link.symlink_to(port)
    for ports, problem in (
        (("a", "b", "a"), "a is given twice"),
        ((str(port), str(link)), f"{port} and {link} are the same port"),
    ):
        result = run("config", "apply", *ports, file("location_id = 7"))
        assert (result.exit_code, result.stdout) == (2, "")
        assert result.stderr.endswith(f"{problem}; give each port once\n")


def test_every_wrong_line_is_named(file: Callable[[str], str]) -> None:
    name = file('location = 1\nlocation_id = "x"\nerror_mode = 1\ntransmit_delay = []\n')
    result = run("config", "apply", "/dev/no-such-port", name)
    assert result.exit_code == 1
    assert [line.partition(": there")[0] for line in result.stderr.splitlines()] == [
        f"xbus: {name}: line 1, location",
        f'xbus: {name}: line 2, location_id: "x" is not a whole number',
        f"xbus: {name}: line 4, transmit_delay: [] is not a whole number",
    ]


def test_a_file_for_another_product_needs_force(
    behind: Callable[[SimulatedDevice], str], file: Callable[[str], str]
) -> None:
    name = file('product = "MTi-680G"\nlocation_id = 7\ngnss_lever_arm = { x = 0, y = 0, z = 1 }\n')
    sim = SimulatedDevice("MTi-630")
    port = behind(sim)
    result = run("config", "apply", port, name)
    assert (result.exit_code, result.stdout) == (1, "")
    assert result.stderr.splitlines() == [
        f'xbus: {name}: line 1, product: the settings are for "MTi-680G", and the product of the device is'
        " MTi-630",
        f"xbus: {name}: line 3, gnss_lever_arm: the MTi-630 does not have this setting; nothing was sent;"
        " --force applies the settings that the device supports",
    ]
    shown = run("config", "diff", port, name, "--exit-code")
    assert shown.exit_code == 1
    assert f"xbus: {name} is for 'MTi-680G', the device is MTi-630\n" in shown.stderr
    forced = run("config", "apply", port, name, "--force")
    assert forced.exit_code == 0
    assert forced.stdout == "- location_id = 0\n+ location_id = 7\n"
    assert forced.stderr.splitlines() == [
        f"xbus: skipped: {name}: line 3, gnss_lever_arm: the MTi-630 does not have this setting",
        "xbus: 1 setting set and read back",
    ]
    assert connect(sim).settings().location_id == 7


def test_diff_reports_differences_as_exit_status(
    behind: Callable[[SimulatedDevice], str], file: Callable[[str], str]
) -> None:
    port = behind(SimulatedDevice("MTi-630"))
    for text, status in (("location_id = 0", 0), ("location_id = 1", 1)):
        result = run("config", "diff", port, file(text), "--exit-code")
        assert result.exit_code == status
        assert run("config", "diff", port, file(text)).exit_code == 0


def test_json(behind: Callable[[SimulatedDevice], str], file: Callable[[str], str]) -> None:
    sim = SimulatedDevice("MTi-630")
    port = behind(sim)
    dumped = json.loads(run("config", "dump", port, "--json").stdout)
    assert dumped.pop("product") == "MTi-630"
    assert dumped == {
        name: value for name, value in tomllib.loads(run("config", "dump", port).stdout).items()
        if name != "product"
    }  # fmt: skip
    name = file(
        'location_id = 7\noutput_configuration = [{ quantity = "acceleration", frequency = 100 }]'
    )
    (first, second) = json.loads(run("config", "diff", port, name, "--json").stdout)
    assert first["setting"] == "output_configuration"
    assert first["after"] == [
        {"quantity": "acceleration", "precision": "Float32", "frequency": 100}
    ]
    assert second == {"setting": "location_id", "before": 0, "after": 7}
    planned = json.loads(run("config", "apply", port, name, "--json", "--dry-run").stdout)
    assert planned["dry_run"] is True
    done = json.loads(run("config", "apply", port, name, "--json").stdout)
    assert done == {
        "changes": [first, second],
        "rounded": [],
        "skipped": [],
        "needs_reset": False,
        "dry_run": False,
    }
    assert done["changes"] == planned["changes"]
    assert json.loads(run("config", "diff", port, name, "--json").stdout) == []


def test_json_of_settings_applied_in_part(
    monkeypatch: pytest.MonkeyPatch, file: Callable[[str], str]
) -> None:
    monkeypatch.setattr(
        "xbus.device.connect", lambda *_, **__: Stubborn("SetLocationID", says_so=True)
    )
    name = file('location_id = 7\nfilter_profile = "Robust/VRU"')
    result = run("config", "apply", "mti", name, "--json")
    assert result.exit_code == 1
    facts = json.loads(result.stdout)
    assert [change["setting"] for change in facts.pop("changes")] == ["filter_profile"]
    assert facts == {"failed": "location_id", "failed_is_unknown": False, "not_applied": []}


def test_a_refused_setting_is_reported_with_those_applied(
    monkeypatch: pytest.MonkeyPatch, file: Callable[[str], str]
) -> None:
    monkeypatch.setattr(
        "xbus.device.connect", lambda *_, **__: Stubborn("SetLocationID", says_so=True)
    )
    name = file('location_id = 7\nfilter_profile = "Robust/VRU"')
    result = run("config", "apply", "mti", name)
    assert result.exit_code == 1
    assert result.stdout.count("\n+ ") == 2
    assert result.stderr == (
        "xbus: the device answered SetLocationID with Error 33; applied: filter_profile; not applied:"
        f" location_id; apply {name} again to continue; the lines with - show the old values\n"
    )


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_interrupted_apply_reports_its_progress(
    monkeypatch: pytest.MonkeyPatch, file: Callable[[str], str], number: int, code: int
) -> None:
    command = Device.command

    def interrupted(self: Device, name: str, value: Any = None) -> Any:
        if name == "SetLocationID":
            signal.raise_signal(number)
        return command(self, name, value)

    monkeypatch.setattr(Device, "command", interrupted)
    result = run("config", "apply", "sim:MTi-630", file("location_id = 7"))
    assert result.exit_code == code
    assert "interrupted; applied: nothing; unknown: location_id" in result.stderr


def test_recording_with_a_file(tmp_path: Path, file: Callable[[str], str]) -> None:
    name = file(
        'output_configuration = [{ quantity = "packet_counter" },'
        '{ quantity = "acceleration", frequency = 50 }]'
    )
    out = tmp_path / "walk.mtb"
    result = run("record", "sim:MTi-630", "-o", str(out), "--config", name, "--duration", "1")
    assert result.exit_code == 0, result.output
    assert list(xbus.read_log(out)) == ["packet_counter", "acceleration"]
    bad = file("gnss_lever_arm = { x = 0, y = 0, z = 1 }")
    words = ("record", "sim:MTi-630", "-o", str(tmp_path / "b.mtb"), "--config", bad)
    assert "the MTi-630 does not have this setting" in sentence(run(*words))
    assert not (tmp_path / "b.mtb").exists()


def test_a_file_that_cannot_be_written(tmp_path: Path) -> None:
    out = tmp_path / "nowhere" / "mti.toml"
    printed = sentence(run("config", "dump", "sim:MTi-3", "-o", str(out)))
    assert printed == f"cannot write {out}: No such file or directory; check the path"


@pytest.mark.parametrize("command", ["dump", "diff", "apply"])
def test_help(command: str) -> None:
    result = run("config", command, "--help")
    assert max(map(len, result.stdout.splitlines())) <= 80
    assert "Example: xbus config " in result.stdout
