"""The devices that the studio has open, their recordings and notes, without a browser."""

from __future__ import annotations

import asyncio
import errno
import json
import os
import signal
import socket
import threading
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("nicegui", reason="the extra studio is not installed")

import xbus
from conftest import OWN_CAPTURES
from test_cli import start
from xbus.cli.export_formats import EXPORTS
from xbus.device.rotation import parse_rotation
from xbus.sim import Faults
from xbus.studio.commands import describe
from xbus.studio.health import health
from xbus.studio.hub import Hub, HubError
from xbus.studio.library import Entry, find_recordings
from xbus.studio.pages.record import _rotation_problem, _table
from xbus.studio.pages.recording_card import FORMATS, file_facts, notes_of, summary_of
from xbus.studio.recording import NOTES, Note, read_notes
from xbus.watch.model import Clipped

resource = pytest.importorskip("resource", reason="not on Windows")


@pytest.fixture
def hub(tmp_path: Any) -> Any:
    hub = Hub(tmp_path)
    yield hub
    hub.close_all()


def test_devices_of_the_same_title_have_their_ports_too(hub: Any) -> None:
    for source in ("sim:MTi-3", "sim:MTi-3?bus=i2c", "sim:MTi-630"):
        hub.open(source)
    title = hub.stations["sim:MTi-3"].title
    assert {source: title for source, (_, title) in hub.titled().items()} == {
        "sim:MTi-3": f"{title}, sim:MTi-3",
        "sim:MTi-3?bus=i2c": f"{title}, sim:MTi-3?bus=i2c",
        "sim:MTi-630": hub.stations["sim:MTi-630"].title,
    }


def test_a_replay_has_the_name_of_its_file(hub: Any) -> None:
    source = f"replay:{OWN_CAPTURES / 'walk.mtb'}"
    title = hub.open(source).title
    assert title == "MTi-680G 008000A1B2"
    assert hub.titled()[source][1] == f"{title}, walk.mtb"


def test_a_replay_does_not_have_the_identity_of_a_virtual_device(hub: Any, tmp_path: Any) -> None:
    path = tmp_path / "walk.mtb"
    path.write_bytes(xbus.encode_sample({"packet_counter": 1}))
    station = hub.open(f"replay:{path}")
    assert station.device.device_id is not None
    assert (station.title, station.identity.device_id) == ("unknown product", None)


def test_counts_are_cleared(hub: Any) -> None:
    virtual = xbus.SimulatedDevice("MTi-630", faults=Faults(drop=1e-3))
    with xbus.sim.serving(virtual, tcp=True) as port:
        station = hub.open(port)
        station.measure()
        wait_until(lambda: station.model.counts.skipped_bytes)
        station.model.clipped = {"acc x": Clipped(3, station.model.now)}
        assert station.model.has_faults
        assert "acc x" in health(station)
        virtual.faults = Faults()
        wait_until(lambda: (station.byte_rate.value or 0) > 0)
        station.clear_counts()
        wait_until(lambda: not station.model.has_faults)
        strip = health(station)
        assert "clipping" in strip
        assert not {word for word in ("acc x", "damaged", "xbus-fault") if word in strip}
        assert (station.byte_rate.value or 0) > 0  # what is counted for other ends goes on
        assert station.model.events[-1].text == "the counts were cleared"
        hub.close(port)


def test_config_state_is_no_low_rate(hub: Any) -> None:
    station = hub.open("sim:MTi-630")
    station.show_all()
    wait_until(lambda: "all values are current" in health(station))
    station.device.go_to_config()
    wait_until(lambda: station.model.state == "config")
    wait_until(lambda: station.model.current("acceleration") is None)
    strip = health(station)
    assert "Config State" in strip
    assert not {
        word for word in ("Hz", "stopped", " old", "xbus-fault", "xbus-caution") if word in strip
    }
    station.measure()
    wait_until(lambda: "all values are current" in health(station))


@pytest.fixture
def small_files() -> Any:
    """A function that limits the size of files, which ends recordings as a full disk does."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    resource.setrlimit(resource.RLIMIT_FSIZE, before)
    signal.signal(signal.SIGXFSZ, handler)


def wait_until(condition: Any) -> None:
    pause = threading.Event()
    for _ in range(3000):
        if condition():
            return
        pause.wait(0.01)
    raise AssertionError("it has not happened within 30 s")


@pytest.mark.parametrize("bus", ["i2c", "spi"])
def test_a_virtual_device_has_the_options_of_its_name(hub: Any, bus: Any) -> None:
    station = hub.open(f"sim:MTi-3?bus={bus}&device_id=03801234")
    assert station.device.device_id == 0x03801234
    assert not station.device.link.is_line
    station.show_all()
    wait_until(lambda: "acceleration" in station.history.series)
    recording = station.start_recording(hub.folder)
    wait_until(lambda: recording.samples > 20)
    assert hub.close(station.source) is None
    log = xbus.read_log(recording.path)
    # A busy machine may be late for the bus, which loses samples; they are counted.
    assert log.stats.lost_samples <= station.device.stats.lost_samples
    assert log.stats.skipped_bytes == 0
    assert len(log) == recording.samples


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        ("sim:MTi-9", "no product is called 'MTi-9'"),
        ("sim:MTi-3?bus=can", "bus must be i2c or spi"),
        ("sim:MTi-630?bus=i2c", "neither I²C nor SPI"),
        ("sim:MTi-3?colour=red", "no option colour"),
        ("replay:/nowhere.mtb", "No such file"),
        (f"replay:{os.devnull}", "no frame of a device"),
    ],
)
def test_a_virtual_device_that_does_not_exist(hub: Any, source: Any, reason: Any) -> None:
    with pytest.raises(HubError, match=reason):
        hub.open(source)
    assert hub.stations == {}


def test_devices_with_similar_names_have_different_keys(hub: Any, tmp_path: Any) -> None:
    sources = []
    for name in ("歩.mtb", "走.mtb", "a 1.mtb", "a-1.mtb"):
        path = tmp_path / name
        path.write_bytes(Path("tests/captures/walk.mtb").read_bytes())
        sources.append(f"replay:{path}")
    assert len({hub.open(source).key for source in sources}) == len(sources)


def test_the_port_of_a_page_that_is_not_open(hub: Any) -> None:
    assert hub.source_of("sim-MTi-630") == "sim:MTi-630"
    source = "sim:MTi-630?seed=3"
    key = hub.open(source).key
    hub.close(source)
    assert hub.source_of(key) == source
    assert hub.source_of("dev-ttyNOWHERE") is None


def test_a_recording_that_ends_early_is_told_when_the_device_is_closed(
    hub: Any, small_files: Any
) -> None:
    station = hub.open("sim:MTi-630")
    station.show_all()
    recording = station.start_recording(hub.folder)
    small_files(20_000)
    assert station.is_recording
    wait_until(lambda: recording.error is not None)
    assert not station.is_recording
    assert len({recording.seconds for _ in range(100)}) == 1  # the time stands still
    assert "ended early" in health(station)
    assert "ended early" in _table([station])
    (problem,) = hub.close_all()
    assert problem.startswith(f"{recording.path.name} ended early: ")
    assert problem.endswith("what came before is kept; check the disk and record again")
    log = xbus.read_log(recording.path)
    assert len(log) == recording.samples > 0
    assert log.stats.skipped_bytes == 0


def test_a_recording_with_a_time_limit_in_several_files(hub: Any) -> None:
    station = hub.open("sim:MTi-630")
    station.show_all()
    recording = station.start_recording(hub.folder, duration=1.0, **parse_rotation("20kB"))
    wait_until(lambda: station.last_recording is recording)
    assert station.recording is None
    assert recording.problem is None
    assert 1 <= recording.seconds < 5
    assert recording.files > 1
    assert f"and {recording.files - 1} more file" in _table([station])
    logs = [xbus.read_log(path) for path in sorted(hub.folder.glob("*.mtb"))]
    assert len(logs) == recording.files
    assert sum(map(len, logs)) == recording.samples
    assert (station.byte_rate.value or 0) > 1000


@pytest.mark.parametrize("text", ["100", "0MB", "fast", "10 days"])
def test_a_rotation_that_is_neither_size_nor_time(text: str) -> None:
    assert _rotation_problem("30min") is _rotation_problem(" ") is _rotation_problem(None) is None
    assert "is neither a size (100MB, 2GB) nor a time" in (_rotation_problem(text) or "")


def test_a_note_is_written_whole_or_not_at_all(hub: Any, small_files: Any) -> None:
    station = hub.open("sim:MTi-630")
    recording = station.start_recording(hub.folder, "one")
    small_files(recording.path.with_name(recording.path.name + NOTES).stat().st_size + 10)
    with pytest.raises(OSError, match=os.strerror(errno.ENOSPC)):
        recording.add_note("two, which is longer than the space that is left")
    small_files(resource.RLIM_INFINITY)
    recording.add_note("three")
    assert [note.text for note in read_notes(recording.path)] == ["one", "three"]


def test_a_note_may_contain_any_character(hub: Any) -> None:
    recording = hub.open("sim:MTi-630").start_recording(hub.folder, "")
    texts = ["a\u2028b\u2029c", "d\x85e", "f\ng\r\x0bh\x1ei", "\U0001f600"]
    for text in texts:
        recording.add_note(text)
    assert [note.text for note in read_notes(recording.path)] == texts


@pytest.mark.parametrize(
    "line",
    [
        "no JSON",
        "null",
        "[1]",
        "{}",
        '{"time": "yesterday", "text": "x"}',
        '{"time": "0001-01-01T00:00:00", "text": "x"}',
        '{"time": "9999-12-31T23:59:59-23:00", "text": "x"}',
        "[" * 100_000,
    ],
    ids=lambda line: line[:30],
)
def test_a_line_that_is_no_note_is_left_out(tmp_path: Any, line: Any) -> None:
    good = json.dumps({"time": "2026-11-29T15:04:05.123+00:00", "text": "a knock"})
    (tmp_path / f"walk.mtb{NOTES}").write_text(f"{line}\n{good}\n", encoding="utf-8")
    assert [note.text for note in read_notes(tmp_path / "walk.mtb")] == ["a knock"]


def test_a_link_to_a_recording_that_is_gone_is_left_out(tmp_path: Any) -> None:
    (tmp_path / "gone.mtb").symlink_to(tmp_path / "nowhere")
    (tmp_path / "walk.mtb").write_bytes(b"")
    assert [each.path.name for each in find_recordings(tmp_path).entries] == ["walk.mtb"]


def test_the_summary_of_a_recording_claims_no_more_than_is_known(tmp_path: Any) -> None:
    """Without a packet counter, losses are not detected."""
    for name, extra in {"counted": {"packet_counter": 1}, "uncounted": {}}.items():
        sample = xbus.encode_sample({"temperature": 20.0, **extra})
        (tmp_path / f"{name}.mtb").write_bytes(sample)
    texts = {
        name: summary_of(asyncio.run(describe(Entry((tmp_path / f"{name}.mtb",), 0, 0))))
        for name in ("counted", "uncounted")
    }
    assert "no samples lost" in texts["counted"]
    assert "no packet counter to detect losses" in texts["uncounted"]
    assert all("duration not known" in text and "0.0 s" not in text for text in texts.values())


def test_what_files_and_notes_show() -> None:
    path = Path("walk.mtb")
    day = datetime(2026, 11, 29, 15, 4).timestamp()
    assert file_facts(Entry((path, path), 2_000_000, day)) == "2 files, 2.0 MB, 2026-11-29 15:04"
    packed = Entry((Path("walk.mtb.gz"),), 2_000_000, 1e20)  # no date has this time
    assert file_facts(packed) == "2.0 MB compressed"
    shown = notes_of([Note(day, "<b>"), *[Note(day, "")] * 1100])
    assert shown.startswith("<div>15:04:00 &lt;b&gt;</div><div>15:04:00 marker</div>")
    assert shown.endswith("<div>and 1,081 more</div>")


def test_a_recording_can_be_exported_to_every_format() -> None:
    assert set(FORMATS) == {".parquet", ".csv", *EXPORTS}


def test_two_pages_start_and_end_corrections(hub: Any) -> None:
    station = hub.open("sim:MTi-680G")
    station.measure()

    def forwarding() -> int:
        return sum(thread.name == "xbus-rtk" for thread in threading.enumerate())

    # Nothing listens there; the corrections wait and try again.
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        caster = f"127.0.0.1:{unused.getsockname()[1]}"
    threads = [
        threading.Thread(target=station.start_corrections, args=(caster, "NEAR")) for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    wait_until(lambda: forwarding() == 1)
    station.stop_corrections()
    wait_until(lambda: forwarding() == 0)


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGINT for one process")
def test_the_studio_runs_although_nobody_reads_its_output(tmp_path: Any) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = free.getsockname()
    ours, theirs = os.pipe()
    os.close(ours)
    command = ["studio", "--no-browser", "--port", str(address[1]), "--folder", str(tmp_path)]
    with start(*command, stdout=theirs) as child:
        os.close(theirs)
        wait_until(lambda: child.poll() is not None or _answers(address))
        child.send_signal(signal.SIGINT)
        _, shown = child.communicate()
    assert (child.returncode, shown) == (0, b"")


def test_a_device_that_cannot_be_opened_ends_the_studio(tmp_path: Any) -> None:
    command = ["studio", "--no-browser", "--port", "0", "--folder", str(tmp_path), "sim:MTi-9"]
    with start(*command) as child:
        printed, shown = child.communicate()
    assert (child.returncode, printed) == (1, b"")
    assert shown.startswith(b"xbus: ")
    assert b"MTi-9" in shown
    assert shown.count(b"\n") == 1


def _answers(address: tuple[str, int]) -> bool:
    try:
        with socket.create_connection(address, timeout=20) as connection:
            connection.sendall(b"GET / HTTP/1.0\r\n\r\n")
            return connection.recv(100).startswith(b"HTTP/")
    except OSError:
        return False
