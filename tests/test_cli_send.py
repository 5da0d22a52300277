"""``xbus send``: one message, and what comes back."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable
from typing import Any

import pytest
from click.testing import Result

from streams import frame
from test_cli import run, sentence, start
from xbus import SimulatedDevice, connect
from xbus.cli.exchange import show_exchange
from xbus.device import Device
from xbus.protocol import State
from xbus.sim import serving
from xbus.sim.faults import Faults
from xbus.sim.link import SimLink

AHS = "sim:MTi-630"
INVALID = "4: the message is invalid here, or this device does not know it"


def exchange(*args: str) -> list[str]:
    """Returns the lines of a command that succeeds, without the hex."""
    result = run("send", *args)
    assert result.exit_code == 0, result.output
    return [f"{line[:2]}{line[26:].partition('  ')[2]}" for line in result.stdout.splitlines()]


def wrong(*args: str) -> str:
    """Returns the error message of a wrong call, which prints nothing else."""
    result = run("send", *args)
    assert (result.exit_code, result.stdout) == (2, "")
    return " ".join(result.stderr.partition("Error: ")[2].split())


# Output


def test_words_and_hex() -> None:
    result = run(
        "send", AHS, "--config", "SetOutputConfiguration", "data_id=Quaternion|NED,frequency=100"
    )
    assert result.stdout.splitlines() == [
        "> FA FF C0 04 20 14 00 64 A5  SetOutputConfiguration  data_id=Quaternion|NED,frequency=100",
        "< FA FF C1 04 20 14 00 64 A4  SetOutputConfigurationAck  data_id=Quaternion|NED,frequency=100",
    ]
    assert (result.exit_code, result.stderr) == (0, "")


def test_json() -> None:
    result = run("send", AHS, "--config", "--json", "ReqDID")
    assert [json.loads(line) for line in result.stdout.splitlines()] == [
        {"direction": "to device", "bid": 255, "mid": 0, "name": "ReqDID", "text": "", "value": None,
         "frame": "FAFF000001"},
        {"direction": "to host", "bid": 255, "mid": 1, "name": "DeviceID", "text": "00800040D2",
         "value": 0x800040D2, "frame": "FAFF010800000000800040D266"},
    ]  # fmt: skip
    result = run("send", AHS, "--json", "--hex", "FAFF3000D0")
    assert [json.loads(line) for line in result.stdout.splitlines()] == [
        {"direction": "to device", "length": 5, "reason": "checksum", "frame": "FAFF3000D0"}
    ]


def value_of(*args: str, product: str = AHS) -> Any:
    """Returns the value in the answer to a message."""
    result = run("send", product, "--config", "--json", *args)
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout.splitlines()[-1])["value"]


def test_the_fields_of_an_answer_are_json() -> None:
    assert value_of("ReqFWRev") == {
        "major": 1, "minor": 6, "revision": 0, "build": 114, "scm": 108021
    }  # fmt: skip
    assert value_of("ReqOutputConfiguration")[2:] == [
        {"data_id": 0x2010, "frequency": 100},
        {"data_id": 0xE020, "frequency": 0xFFFF},
    ]
    assert value_of("RunSelftest")[:2] == ["acc_x", "acc_y"]
    assert value_of("ReqFilterProfile") == "Responsive/NorthReference"
    assert value_of("ReqPortConfig")[0]["protocol"] == "xbus"
    assert value_of("ReqConfiguration")["firmware"]["minor"] == 6
    assert value_of("ReqSyncSettings", product="sim:MTi-680G")[0]["line"] == "in3"
    assert value_of("ReqLatLonAlt", product="sim:MTi-680G")["lat"] == 52.24049169408207


#: Arguments of the command line, and the expected answer.
ANSWERED = """
    MTi-630  ReqOptionFlags                              | ReqOptionFlagsAck  0
    MTi-630  reqoptionflags                              | ReqOptionFlagsAck  0
    MTi-630  SetOptionFlags set=enable_in_run_compass_calibration clear=0 | SetOptionFlagsAck
    MTi-630  SetBaudrate 0x80                            | SetBaudrateAck
    MTi-630  ReqFilterProfile                            | ReqFilterProfileAckModern  Responsive/
    MTi-630  SetFilterProfileModern Responsive           | SetFilterProfileAck
    MTi-3    ReqFilterProfile                            | ReqFilterProfileAck  version=1 profile=50
    MTi-630  SetOutputConfiguration                      | SetOutputConfigurationAck  none
    MTi-630  ReqOutputConfiguration                      | ReqOutputConfigurationAck  data_id=
    MTi-630  SetAlignmentRotation parameter=0 quaternion=1,0,0,0 | SetAlignmentRotationAck
    MTi-630  ReqProductCode                              | ProductCode  MTi-630-8A1G6
    MTi-630  GoToMeasurement                             | GoToMeasurementAck
"""


@pytest.mark.parametrize("line", ANSWERED.strip().splitlines())
def test_replies_are_named_after_the_command(line: str) -> None:
    call, _, answer = line.partition("|")
    product, *words = call.split()
    question, printed = exchange(f"sim:{product}", "--config", *words)
    assert question.lower().startswith(f"> {words[0]}".lower())
    assert printed.startswith(f"< {answer.strip()}")


@pytest.mark.parametrize("words", [["ReqData"], ["--hex", "3F"], ["--hex", "34", "--wait", "0"]])
def test_messages_without_an_answer(words: list[str]) -> None:
    (line,) = exchange(AHS, *words)
    assert line in ("> ReqData", "> WakeUpAck")


def test_samples_are_counted() -> None:
    result = run("send", AHS, "GoToConfig")
    assert result.stderr == ""
    result = run("send", AHS, "ReqData", "--wait", "0.25")
    assert result.stdout.splitlines() == ["> FA FF 34 00 CD            ReqData"]
    assert result.stderr == "xbus: 25 samples not shown\n"


def test_wait_extends_the_exchange() -> None:
    lines = exchange(AHS, "Reset", "--wait", "2")
    assert [line.split()[1] for line in lines[:3]] == ["Reset", "ResetAck", "WakeUp"]


# Bytes in hex


@pytest.mark.parametrize(
    "words", ["FA FF 30 00 D1", "FAFF3000D1", "fa,ff,30,00,d1", "0xFA 0xFF 0x30 0x00 0xD1", "30"]
)
def test_hex(words: str) -> None:
    assert exchange(AHS, "--hex", *words.split()) == ["> GoToConfig", "< GoToConfigAck"]


def test_a_mid_with_data() -> None:
    words = ["C0", "4020", "0064"]
    assert exchange(AHS, "--config", "--hex", *words) == [
        "> SetOutputConfiguration  data_id=Acceleration,frequency=100",
        "< SetOutputConfigurationAck  data_id=Acceleration,frequency=100",
    ]


def test_bytes_without_a_frame_are_sent_unchanged() -> None:
    result = run("send", AHS, "--hex", "FA FF 30 00 D0")
    assert result.stdout == "> FA FF 30 00 D0            5 bytes without a frame: checksum\n"
    assert (result.exit_code, result.stderr) == (0, "xbus: 50 samples not shown\n")


def test_a_frame_is_shown_as_it_was_written() -> None:
    """The extended form of a short length is kept."""
    result = run("send", AHS, "--hex", "FA FF 30 FF 00 00 D2")
    assert result.stdout.startswith("> FA FF 30 FF 00 00 D2      GoToConfig\n")


@pytest.mark.parametrize("words", ["", " ", "zz", "FA F", "3 0", "0x", "FA-FF"])
def test_invalid_hex_is_a_wrong_call(words: str) -> None:
    assert wrong(AHS, "--hex", words).endswith("is not hex; write bytes, such as FA FF 30 00 D1")


def test_an_error_to_bytes_in_hex() -> None:
    result = run("send", AHS, "--hex", "00")
    assert [line[28:] for line in result.stdout.splitlines()] == [
        "ReqDID",
        f"Error  {INVALID}",
    ]
    assert result.exit_code == 1
    assert result.stderr.splitlines() == [
        "xbus: 50 samples not shown",
        f"xbus: the device sent Error {INVALID}",
    ]


# States


def test_a_device_is_left_as_it_was_found(behind: Callable[[SimulatedDevice], str]) -> None:
    sim = SimulatedDevice("MTi-630")
    port = behind(sim)
    for words in (["ReqDID"], ["--hex", "10"], ["--hex", "00"], ["GoToMeasurement"], ["Reset"]):
        run("send", port, "--config", *words)
        assert sim.state == State.MEASUREMENT
    exchange(port, "GoToConfig")
    for words in (["ReqDID"], ["--config", "ReqDID"]):
        exchange(port, *words)
        assert sim.state == State.CONFIG
    exchange(port, "GoToMeasurement")
    assert sim.state == State.MEASUREMENT


@pytest.mark.parametrize(
    ("words", "advice"),
    [
        ("ReqDID", "add --config, or send GoToConfig first"),
        ("GoToMeasurement", "add --config, or send GoToConfig first"),
        ("--config SetNoRotation 6", "remove --config"),
        ("WakeUpAck", "send GoToConfig, which is valid in any state"),
    ],
)
def test_a_message_in_the_wrong_state_is_not_sent(words: str, advice: str) -> None:
    printed = sentence(run("send", AHS, *words.split()))
    assert printed.endswith(f"; nothing was sent; {advice}")
    assert " State, but the state is " in printed


def test_a_message_for_measurement_state_names_gotomeasurement(
    behind: Callable[[SimulatedDevice], str],
) -> None:
    port = behind(SimulatedDevice("MTi-630"))
    exchange(port, "GoToConfig")
    assert sentence(run("send", port, "ReqData")).endswith("; send GoToMeasurement first")


# Failures: the exit status is 2 for a wrong call, and 1 for a call that is wrong for this device


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("Nonsense", "no message to a device is called 'Nonsense'; xbus messages lists them"),
        ("ReqDI", "no message to a device is called 'ReqDI'; did you mean ReqDID?"),
        ("GoToConfigAck", "no message to a device is called 'GoToConfigAck'; did you mean "),
        ("ReqDID 5", "ReqDID: no field is called '5'; there are: none"),
        ("SetSyncSettings function=send_latest", "SetSyncSettings: fields are missing: line"),
        ("SetOptionFlags sets=1", "SetOptionFlags: no field is called 'sets'; there are: set, clear"),
        ("SetOptionFlags set=wings clear=0", "SetOptionFlags: set: 'wings' is not one of DISABLE_"),
        ("SetBaudrate 300", "SetBaudrate: code cannot be 300: it must be an integer from 0 to 255"),
        ("SetInitialHeading 500", "SetInitialHeading: the heading must be from -180 to 180 degrees"),
        ("SetInitialHeading x", "SetInitialHeading: heading: could not convert string to float: 'x'"),
        ("SetOutputConfiguration frequency=1", "SetOutputConfiguration: fields are missing: data_id"),
        ("--bid 40 ReqDID", "a device has the bus identifier 0xFF or 1 to 31, not 40"),
        ("--baudrate 0 ReqDID", "Invalid value for '--baudrate'"),
        ("--wait -1 ReqDID", "Invalid value for '--wait'"),
        ("", "Missing argument 'MESSAGE [FIELD=VALUE]...'"),
    ],
)  # fmt: skip
def test_wrong_call(words: str, says: str) -> None:
    """The error comes before the port, which does not exist, is opened."""
    assert says in wrong("/dev/nowhere", *words.split())


@pytest.mark.parametrize(
    ("port", "says"),
    [
        (
            "sim:MTi-63",
            "sim:MTi-63 is not a port: no product is called 'MTi-63'; there are MTi-1, ",
        ),
        ("bogus://x", "bogus://x is not a port: invalid URL, protocol 'bogus' not known"),
    ],
)
def test_no_port(port: str, says: str) -> None:
    assert wrong(port, "ReqDID").startswith(says)


@pytest.mark.parametrize(
    ("port", "says"),
    [
        ("nowhere", "No such file or directory; xbus ports lists the serial ports"),
        (".", "Is a directory; xbus ports lists the serial ports"),
        ("/dev/null", "Inappropriate ioctl for device; xbus ports lists the serial ports"),
        ("socket://127.0.0.1:1", "Connection refused; start the program that listens on it"),
    ],
)
def test_a_port_that_cannot_be_opened(port: str, says: str) -> None:
    assert sentence(run("send", port, "ReqDID")) == f"cannot open {port}: {says}"


def test_a_port_that_is_taken() -> None:
    with serving(SimulatedDevice("MTi-630")) as port, connect(port):
        printed = sentence(run("send", port, "ReqDID"))
    assert (
        printed
        == f"cannot open {port}: Resource temporarily unavailable; close the program that uses it"
    )


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("ReqGnssPlatform", "the MTi-630 does not support ReqGnssPlatform, nothing was sent; supported by: "),
        ("SetBaudrate 99", "the MTi-630 does not support code 99 baud; "),
        ("SetOutputConfiguration data_id=LatLon,frequency=4", "the MTi-630 has no output lat_lon; "),
        ("SetOptionFlags set=enable_ahs clear=0", "the MTi-630 has no option flag ENABLE_AHS; "),
    ],
)  # fmt: skip
def test_messages_that_the_product_lacks_are_not_sent(words: str, says: str) -> None:
    printed = sentence(run("send", AHS, "--config", *words.split()))
    assert printed.startswith(says)
    assert "nothing was sent" in printed


def failed(result: Result) -> tuple[list[str], str]:
    """Returns the exchange so far, and the error message."""
    assert result.exit_code == 1
    *_, printed = result.stderr.splitlines()
    assert printed.startswith("xbus: ")
    return [line.split("  ")[-1].strip() for line in result.stdout.splitlines()], printed


def test_an_error(behind: Callable[[SimulatedDevice], str]) -> None:
    """Without --config the product is not known, so the device itself refuses the message."""
    port = behind(SimulatedDevice("MTi-630"))
    exchange(port, "GoToConfig")
    shown, printed = failed(run("send", port, "ReqGnssPlatform"))
    assert shown == ["ReqGnssPlatform", INVALID]
    assert printed == f"xbus: the device answered ReqGnssPlatform with Error {INVALID}"


def test_no_answer() -> None:
    shown, printed = failed(run("send", AHS, "--bid", "2", "GoToConfig"))
    # Every 0.2 s, for 2 s and the time that bytes may wait on the line.
    assert shown == ["GoToConfig"] * 12
    assert "no answer to GoToConfig from sim:MTi-630 within 2.4 s" in printed


@pytest.mark.parametrize("words", [["Reset", "--wait", "5"], ["--hex", "30", "--wait", "5"]])
def test_a_pulled_plug(words: list[str], behind: Callable[[SimulatedDevice], str]) -> None:
    sim = SimulatedDevice("MTi-630", faults=Faults.parse(["unplug=2:60"], 0))
    shown, printed = failed(run("send", behind(sim), *words))
    assert len(shown) >= 2
    assert printed == (
        "xbus: sim:MTi-630 was lost while listening: sim:MTi-630 was unplugged; check the cable;"
        " the next command opens the port again"
    )


def test_a_plug_pulled_before_the_answer(
    behind: Callable[[SimulatedDevice], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    sim = SimulatedDevice("MTi-630")
    port = behind(sim)
    write = SimLink.write

    def last_words(self: SimLink, data: bytes) -> None:
        write(self, data)
        monkeypatch.setattr(SimulatedDevice, "plugged", False)

    monkeypatch.setattr(SimLink, "write", last_words)
    shown, printed = failed(run("send", port, "GoToConfig"))
    assert shown == ["GoToConfig"]
    assert "sim:MTi-630 was lost during GoToConfig" in printed


def test_ctrl_c() -> None:
    sim = SimulatedDevice("MTi-630")
    with serving(sim) as port, start("send", port, "--config", "ReqDID", "--wait", "60") as child:
        assert child.stdout is not None
        assert child.stdout.readline().endswith(b"ReqDID\n")
        assert child.stdout.readline().endswith(b"00800040D2\n")
        child.send_signal(signal.SIGINT)
        out, printed = child.communicate(timeout=20)
    assert (child.returncode, out, printed) == (130, b"", b"")
    assert sim.state == State.MEASUREMENT


def test_over_a_port() -> None:
    with serving(SimulatedDevice("MTi-3")) as port:
        assert exchange(port, "--config", "ReqProductCode") == [
            "> ReqProductCode",
            "< ProductCode  MTi-3-8A7G6",
        ]


# Pieces of samples at both ends of an exchange


SAMPLE = frame(0x36, bytes.fromhex("10 20 02 00 01"))


@pytest.mark.parametrize(
    ("state", "pieces", "lines"),
    [
        (State.MEASUREMENT, [SAMPLE[4:], SAMPLE[:7]], []),
        (State.MEASUREMENT, [SAMPLE, b"\0\0\0", SAMPLE], ["3 bytes without a frame: no preamble"]),
        (State.CONFIG, [b"\0\0\0", frame(0x31)], ["3 bytes without a frame: no preamble", "GoToConfigAck"]),
        (State.CONFIG, [frame(0x31)[:4]], ["4 bytes without a frame: truncated"]),
        (State.CONFIG, [frame(0x11), SAMPLE, SAMPLE[:4]], ["GoToMeasurementAck"]),
    ],
)  # fmt: skip
def test_pieces_of_samples_are_not_damage(
    state: State, pieces: list[bytes], lines: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    device = Device(SimLink("sim:MTi-630"))
    device.session.state = state
    with show_exchange(device, as_json=False):
        for piece in pieces:
            device.link.acquisition.push(piece, 0.0)
            device.listen(0)
    assert [line[28:] for line in capsys.readouterr().out.splitlines()] == lines


def test_messages_after_an_exchange_are_not_shown(capsys: pytest.CaptureFixture[str]) -> None:
    device = Device(SimLink("sim:MTi-630"))
    device.go_to_config()
    with show_exchange(device, as_json=False):
        device.commands.req_did()
    shown = [line.split("  ")[0] for line in capsys.readouterr().out.splitlines()]
    assert shown == ["> FA FF 00 00 01", "< FA FF 01 08 00 00 00 00 80 00 40 D2 66"]
    device.commands.req_did()
    assert capsys.readouterr().out == ""
