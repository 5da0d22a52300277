"""Recordings of a folder, their pictures, and their replay, without a browser."""

from __future__ import annotations

import asyncio
import gzip
import os
import shutil
import time
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import click
import numpy as np
import pytest

import xbus
from conftest import OWN_CAPTURES
from xbus.cli import main
from xbus.cli.failure import Failure
from xbus.cli.studio import _sources
from xbus.log.pacing import ReplayPace
from xbus.studio import commands, library, replaying, sampled, thumbnail
from xbus.studio.commands import command_line
from xbus.studio.drawing import cloud, curve
from xbus.studio.library import FileCache, find_recordings, unused_path
from xbus.studio.replaying import Replaying, replay_source

WALK = OWN_CAPTURES / "walk.mtb"


def split(folder: Path) -> list[Path]:
    """Splits the walk into pieces of 3 s, and returns them."""
    words = ["split", str(WALK), "--time", "3s", "--out-dir", str(folder), "-q"]
    main(words, standalone_mode=False)
    return sorted(folder.glob("*.mtb"), key=lambda path: (len(path.name), path.name))


def names(folder: Path) -> list[list[str]]:
    entries = find_recordings(folder).entries
    return sorted([str(file.relative_to(folder)) for file in each.files] for each in entries)


def test_pieces_are_one_recording_and_folders_are_searched(tmp_path: Path) -> None:
    pieces = split(tmp_path / "day" / "one")
    assert len(pieces) == 4
    shutil.copy(WALK, tmp_path / "other.MTB")
    (tmp_path / ".hidden").mkdir()
    shutil.copy(WALK, tmp_path / ".hidden" / "walk.mtb")
    (tmp_path / "folder.mtb").mkdir()
    (tmp_path / "walk.html").write_text("no recording")
    expected = [str(path.relative_to(tmp_path)) for path in pieces]
    assert names(tmp_path) == [expected, ["other.MTB"]]
    found = next(each for each in find_recordings(tmp_path).entries if len(each.files) > 1)
    assert found.size == sum(path.stat().st_size for path in pieces)
    assert found.heading == "walk.mtb to walk-0003.mtb"


def write_two(folder: Path) -> list[Path]:
    """Writes recordings of two devices with the names of one recording, and returns them."""
    for name, identifier in {"walk.mtb": "03801234", "walk-0001.mtb": "03805678"}.items():
        head = xbus.encode_frame(xbus.MessageId.DeviceID, bytes.fromhex(identifier))
        (folder / name).write_bytes(head + xbus.encode_sample({"packet_counter": 1}))
    return [folder / "walk.mtb", folder / "walk-0001.mtb"]


def test_a_name_does_not_make_a_piece(tmp_path: Path) -> None:
    write_two(tmp_path)
    assert names(tmp_path) == [["walk-0001.mtb"], ["walk.mtb"]]


def compress(path: Path) -> None:
    """Replaces a file by a compressed one."""
    path.with_name(f"{path.name}.gz").write_bytes(gzip.compress(path.read_bytes()))
    path.unlink()


def test_compressed_recordings_are_listed(tmp_path: Path) -> None:
    data = gzip.compress(WALK.read_bytes())
    for name in ("walk.mtb.gz", "log-2026.mtb.gz", "log-2027.mtb.gz", "one.MTB.zst", "one.mtb.zip"):
        (tmp_path / name).write_bytes(data)
    shutil.copy(WALK, tmp_path / "walk.mtb")
    expected = ["log-2026.mtb.gz", "log-2027.mtb.gz", "one.MTB.zst", "walk.mtb", "walk.mtb.gz"]
    assert names(tmp_path) == [[name] for name in expected]
    entries = {each.path.name: each for each in find_recordings(tmp_path).entries}
    found = entries["walk.mtb.gz"]
    assert (found.plain_path.name, found.is_compressed) == ("walk.mtb", True)
    assert not entries["walk.mtb"].is_compressed


@pytest.mark.parametrize("count", [1, 4])
def test_compressed_pieces_are_one_recording(count: int, tmp_path: Path) -> None:
    """Also while the last ones are not compressed yet."""
    for piece in split(tmp_path)[:count]:
        compress(piece)
    (entry,) = find_recordings(tmp_path).entries
    assert [file.name.removesuffix(".gz") for file in entry.files] == [
        "walk.mtb",
        "walk-0001.mtb",
        "walk-0002.mtb",
        "walk-0003.mtb",
    ]
    assert (entry.plain_path.name, entry.is_compressed) == ("walk.mtb", True)
    assert asyncio.run(commands.describe(entry)).samples == 1040
    assert thumbnail.thumbnail(entry.files) == thumbnail.thumbnail([WALK])
    assert Replaying(replay_source(entry.files)).duration == pytest.approx(9.99, abs=0.02)


def test_compressed_files_that_are_several_recordings(tmp_path: Path) -> None:
    """Their names do not say so; once they are read, it is known."""
    for path in write_two(tmp_path):
        compress(path)
    (entry,) = find_recordings(tmp_path).entries
    with pytest.raises(ValueError, match=r"does not continue .*walk\.mtb\.gz"):
        Replaying(replay_source(entry.files))
    with pytest.raises(commands.CommandError, match="are 2 recordings; read the folder again"):
        asyncio.run(commands.describe(entry))
    assert names(tmp_path) == [["walk-0001.mtb.gz"], ["walk.mtb.gz"]]
    for each in find_recordings(tmp_path).entries:
        assert asyncio.run(commands.describe(each)).samples == 1


def test_names_are_printable(tmp_path: Path) -> None:
    name = os.fsdecode(b"walk\n\xff.mtb")
    (tmp_path / name).write_bytes(b"")
    (entry,) = find_recordings(tmp_path).entries
    assert entry.heading == "walk\\n\ufffd.mtb"
    assert command_line("info", *entry.arguments).endswith("\ufffd.mtb'")


def test_a_folder_that_cannot_be_read_is_not_empty(tmp_path: Path) -> None:
    assert find_recordings(tmp_path / "missing").entries == []
    with pytest.raises(NotADirectoryError):
        find_recordings(WALK)


def test_the_latest_are_listed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for number in range(6):
        path = tmp_path / f"{number}.mtb"
        path.write_bytes(b"")
        os.utime(path, (number, number))
    monkeypatch.setattr(library, "MAX_ENTRIES", 2)
    found = find_recordings(tmp_path)
    assert [each.path.name for each in found.entries] == ["5.mtb", "4.mtb"]
    assert (found.total, found.is_complete) == (6, True)
    monkeypatch.setattr(library, "MAX_LOOKED_AT", 3)
    assert not find_recordings(tmp_path).is_complete


def test_no_file_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "walk.mtb"
    first = unused_path(path, "-cut")
    assert first.name == "walk-cut.mtb"
    first.write_bytes(b"")
    second = unused_path(path, "-cut")
    assert second.name == "walk-cut-2.mtb"
    second.symlink_to(tmp_path / "nowhere")
    assert unused_path(path, "-cut").name == "walk-cut-3.mtb"


def test_what_is_known_is_limited_and_ends_with_a_change(tmp_path: Path) -> None:
    path = tmp_path / "walk.mtb"
    path.write_bytes(b"1")
    cache: FileCache[int] = FileCache(2)
    key = FileCache.key([path])
    cache.put(key, 1)
    assert cache.get(FileCache.key([path])) == 1
    path.write_bytes(b"12")
    assert cache.get(FileCache.key([path])) is None
    cache.put("a", 2)
    assert cache.get(key) == 1
    cache.put("b", 3)  # what was used longest ago is forgotten
    assert (cache.get("a"), cache.get(key)) == (None, 1)


# Pictures


def columns_of(svg: str) -> list[dict[int, tuple[float, float]]]:
    """Returns the ends of each column, for each path."""
    paths = ET.fromstring(svg).findall("path")  # noqa: S314 - our own
    found = []
    for path in paths:
        steps = [step.replace("V", " ").split() for step in path.attrib["d"].split("M")[1:]]
        found.append({int(float(x)): (float(a), float(b)) for x, a, b in steps})
    return found


def test_a_picture_has_the_extremes_of_each_moment() -> None:
    x, y, z = columns_of(thumbnail.thumbnail([WALK]))
    assert list(x) == list(range(thumbnail.COLUMNS)) == list(y) == list(z)
    log = xbus.read_log(WALK)
    values = log["acceleration"].values
    time = log.time[log["acceleration"].sample]
    rows = (time - time[0]) * thumbnail.COLUMNS // (time[-1] - time[0])
    low, high = values.min(), values.max()
    for column in (0, 80, 158):
        own = values[rows == column, 2]
        top, bottom = (
            1 + (thumbnail.HEIGHT - 2) * (high - end) / (high - low)
            for end in (own.max(), own.min())
        )
        assert z[column] == pytest.approx((top - 0.4, bottom + 0.4), abs=0.06)


def test_of_several_devices_the_first_is_drawn(tmp_path: Path) -> None:
    path = tmp_path / "bus.mtb"
    samples = [
        xbus.encode_sample({"packet_counter": at, "acceleration": [float(bid), at, 9.8]}, bid=bid)
        for at in range(400)
        for bid in (2, 1)
    ]
    path.write_bytes(b"".join(samples))
    svg = thumbnail.thumbnail([path])
    assert "<title>acceleration of BID 2, 0 to 399 m/s2</title>" in svg


def count_reads(monkeypatch: pytest.MonkeyPatch, part: int) -> list[int]:
    """Makes every recording a large one that is read in small parts, and returns the sizes of these."""
    monkeypatch.setattr(sampled, "WHOLE", 1000)
    monkeypatch.setattr(sampled, "PART", part)
    read, plain = [], sampled._Bytes.read

    def count(self: Any, start: int, end: int) -> None:
        read.append(end - start)
        plain(self, start, end)

    monkeypatch.setattr(sampled._Bytes, "read", count)
    return read


def test_a_large_recording_is_read_in_parts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = columns_of(thumbnail.thumbnail([WALK]))
    read = count_reads(monkeypatch, 600)
    parts = columns_of(thumbnail.thumbnail(split(tmp_path)))
    assert max(read) == 600
    assert sum(read) < 0.65 * WALK.stat().st_size
    assert [list(line) for line in parts] == [list(range(thumbnail.COLUMNS))] * 3
    tops = [
        (part[at][0], line[at][0]) for part, line in zip(parts, whole, strict=True) for at in part
    ]
    assert np.mean(np.diff(tops)) == pytest.approx(0, abs=1)


def write_rates(path: Path) -> None:
    """Writes 100 Hz for 20 s, nothing for 8 s, and 10 Hz for 12 s."""
    ticks = [*range(2000), *range(2800, 4000, 10)]
    samples = [
        xbus.encode_sample({"sample_time_fine": 100 * tick, "acceleration": [tick, 0.0, 0.0]})
        for tick in ticks
    ]
    path.write_bytes(b"".join(samples))


@pytest.mark.parametrize("part", [None, 60, 150, 300])
def test_a_gap_is_marked_and_a_lower_rate_is_none(
    part: int | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half of the picture has nearly all of the bytes."""
    path = tmp_path / "rates.mtb"
    write_rates(path)
    read = [] if part is None else count_reads(monkeypatch, part)
    svg = thumbnail.thumbnail([path])
    (mark,) = ET.fromstring(svg).findall("rect")  # noqa: S314 - our own
    assert float(mark.attrib["x"]) == pytest.approx(80, abs=0.5)
    assert float(mark.attrib["width"]) == pytest.approx(32, abs=0.5)
    assert ", 1 gap<" in svg
    x = columns_of(svg)[0]
    assert sorted(set(range(thumbnail.COLUMNS)) - set(x)) == list(range(81, 112))
    tops = [x[at][0] for at in x]
    assert tops == sorted(tops, reverse=True)
    assert len(read) < 2 * thumbnail.COLUMNS


def test_without_time_stamps_a_large_recording_is_drawn_by_its_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "walk.mtb"
    rows = [xbus.encode_sample({"acceleration": [float(row), 0.0, 0.0]}) for row in range(3000)]
    path.write_bytes(b"".join(rows))
    count_reads(monkeypatch, 150)
    svg = thumbnail.thumbnail([path])
    assert "<rect" not in svg
    x = columns_of(svg)[0]
    assert list(x) == list(range(thumbnail.COLUMNS))
    assert [x[at][0] for at in x] == sorted((ends[0] for ends in x.values()), reverse=True)


def test_a_compressed_recording_has_a_picture_unless_it_is_huge(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, hidden = tmp_path / "walk.mtb.gz", tmp_path / "hidden.mtb"
    path.write_bytes(gzip.compress(WALK.read_bytes()))
    shutil.copy(path, hidden)  # compressed, and the name does not say so
    expected = thumbnail.thumbnail([WALK])
    assert thumbnail.thumbnail([path]) == thumbnail.thumbnail([hidden]) == expected
    monkeypatch.setattr(sampled, "MOST_DECOMPRESSED", WALK.stat().st_size)
    assert thumbnail.thumbnail([path]) == expected
    monkeypatch.setattr(sampled, "MOST_DECOMPRESSED", WALK.stat().st_size - 1)
    assert "no picture: more than" in thumbnail.thumbnail([path])
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(OSError, match="the compressed data is damaged"):
        thumbnail.thumbnail([path])


def test_of_a_large_compressed_recording_parts_are_decoded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = columns_of(thumbnail.thumbnail([WALK]))
    monkeypatch.setattr(sampled, "SMALL_PART", 400)
    monkeypatch.setattr(sampled, "MOST_SMALL_PARTS", 300)
    pieces = split(tmp_path)
    for piece in pieces:
        compress(piece)
    known = sampled._decompressed([piece.with_name(f"{piece.name}.gz") for piece in pieces])
    assert known is not None
    starts = [part.start for part in known.parts()]
    assert set(np.diff(starts).tolist()) == {800}  # 423 parts of 400 bytes are too many
    found = sampled._decoded(known, ["acceleration"])
    places = sampled.columns_of(found.position, thumbnail.COLUMNS)
    assert np.unique(places).tolist() == list(range(thumbnail.COLUMNS)) == list(whole[0])
    log = xbus.read_log(WALK)
    assert np.isin(found.log["acceleration"].values, log["acceleration"].values).all()
    assert 300 < len(found.log) < 600


@pytest.mark.parametrize("data", [b"", b"no frame" * 100, xbus.encode_frame(0x3E)])
def test_nothing_to_draw(data: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "walk.mtb"
    path.write_bytes(data)
    assert thumbnail.thumbnail([path]) == ""
    monkeypatch.setattr(sampled, "WHOLE", -1)
    assert thumbnail.thumbnail([path]) == ""


@pytest.mark.parametrize("number", [np.nan, np.inf, 3e38, -1e-40])
def test_any_number_can_be_drawn(number: float, tmp_path: Path) -> None:
    rows = [[number, 1.0, 2.0], [-number, number, 0.0], [0.0, 0.0, number]]
    samples = [xbus.encode_sample({"acceleration": row}) for row in rows]
    path = tmp_path / "walk.mtb"
    path.write_bytes(b"".join(samples))
    svg = thumbnail.thumbnail([path])
    for line in columns_of(svg):
        assert all(0 <= end <= thumbnail.HEIGHT for ends in line.values() for end in ends)
    points = np.array(rows)
    time = np.arange(3.0)
    for drawn in (curve("<b>", time, points[:, 0]), cloud([("<b>", points)])):
        assert "nan" not in drawn
        assert "inf" not in drawn
        if drawn:
            ET.fromstring(drawn)  # noqa: S314 - our own


# Replay


def wait_until(condition: Any) -> None:
    until = time.monotonic() + 30
    while not condition():
        assert time.monotonic() < until, "it has not happened within 30 s"
        time.sleep(0.01)


def series(station: Any) -> Any:
    """The times of the samples in the history of a device."""
    found = station.history.series.get("acceleration")
    return np.empty(0) if found is None else found.time


def test_a_replay_goes_to_any_moment_at_any_speed(tmp_path: Path) -> None:
    pytest.importorskip("nicegui", reason="the extra studio is not installed")
    from xbus.studio.health import health
    from xbus.studio.hub import Hub

    hub = Hub(tmp_path)
    try:
        station = hub.open(replay_source(split(tmp_path)))
        replay = station.replaying
        assert replay is not None
        assert replay.duration == pytest.approx(9.99, abs=0.02)
        replay.speed = 10
        station.measure()
        recorded = xbus.read_log(WALK)
        log_time = recorded["acceleration"].time - recorded.time[0]
        wait_until(lambda: len(series(station)) == len(log_time))
        assert replay.position == replay.duration
        # Times and rates are those of the recording, and its end is no fault.
        assert series(station) == pytest.approx(log_time, abs=1e-6)
        for name, rate in {"acceleration": 100, "gnss_pvt_data": 4}.items():
            quantity = station.model.quantities[name, None]
            assert quantity.rate(station.model.now) == pytest.approx(rate, rel=0.1)
        strip = health(station)
        assert "end of the recording" in strip
        assert not {word for word in ("stopped", "nothing for", "xbus-fault") if word in strip}
        replay.speed = 0.5
        station.replay_from(4.0)
        assert 4 <= replay.position < replay.duration
        wait_until(lambda: series(station)[0] == pytest.approx(4.0, abs=0.1))
        assert "at 0.5× speed" in health(station)
        shown = station.history.copy("acceleration", 4.0, 10.0)
        assert shown is not None
        rows = np.searchsorted(log_time, shown.time - 1e-6)
        assert shown.time == pytest.approx(log_time[rows], abs=1e-6)
        assert shown.values == pytest.approx(recorded["acceleration"].values[rows])
        stats = station.device.stats
        assert stats.lost_samples == stats.skipped_bytes == 0
    finally:
        hub.close_all()


UNSTAMPED = b"".join(xbus.encode_sample({"temperature": float(row)}) for row in range(600))


@pytest.mark.parametrize("data", [2 * WALK.read_bytes(), UNSTAMPED], ids=["restart", "unstamped"])
def test_the_times_of_a_replay_are_those_of_the_recording(data: bytes, tmp_path: Path) -> None:
    """Also when the recorded clock steps back, and when another moment is chosen."""
    path = tmp_path / "walk.mtb"
    path.write_bytes(data)
    recorded = ReplayPace().times(xbus.read_log(data))
    replaying = Replaying(replay_source([path]))
    device = xbus.connect(replaying.device)
    blocks = device.blocks(seconds=0.05)
    times = []
    while not replaying.is_over:
        times.append(replaying.times(next(blocks)))
    assert np.concatenate(times) == pytest.approx(recorded)
    assert replaying.now == replaying.duration
    for start in (3.0, 3.3, recorded[-1] - 2, 0.5, 0.45):
        replaying.start_at(start)
        with device.configure():
            pass
        found = np.concatenate([replaying.times(next(blocks)) for _ in range(6)])
        found = found[np.isfinite(found)]  # those before are left out
        first = np.searchsorted(recorded, start - 1e-6)
        assert found == pytest.approx(recorded[first : first + len(found)], abs=1e-6)
        assert len(found) > 20


def test_what_cannot_be_replayed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("nicegui", reason="the extra studio is not installed")
    from xbus.studio.hub import Hub, HubError

    hub = Hub(tmp_path)
    missing = replay_source([tmp_path / "walk.mtb"])
    with pytest.raises(HubError, match=r"^cannot replay walk\.mtb: No such file"):
        hub.open(missing)
    (tmp_path / "walk.mtb").write_bytes(b"no frame")
    with pytest.raises(HubError, match=r"^cannot replay walk\.mtb: the recording has no frame"):
        hub.open(missing)
    monkeypatch.setattr(replaying, "LARGEST", 100_000)
    with pytest.raises(ValueError, match=r"169\.1 kB, and a replay at most 100\.0 kB; cut a part"):
        Replaying(replay_source([WALK]))
    compressed = tmp_path / "walk.mtb.gz"
    compressed.write_bytes(gzip.compress(WALK.read_bytes()))
    with pytest.raises(
        ValueError, match=r"more than 100\.0 kB, and a replay at most 100\.0 kB; cut"
    ):
        Replaying(replay_source([compressed]))


def test_a_name_can_look_like_pieces(tmp_path: Path) -> None:
    path = tmp_path / "one|two.mtb"
    shutil.copy(WALK, path)
    assert Replaying(replay_source([path])).name == "one|two.mtb"


# Arguments


def test_arguments_are_ports_recordings_and_a_folder(tmp_path: Path) -> None:
    pieces = [str(path) for path in split(tmp_path)]
    found, folder = _sources(["/dev/ttyUSB0", *reversed(pieces), str(WALK), str(tmp_path)], None)
    assert found == ["/dev/ttyUSB0", "replay:" + "|".join(pieces), f"replay:{WALK}"]
    assert folder == tmp_path
    assert _sources(["sim:MTi-3"], tmp_path) == (["sim:MTi-3"], tmp_path)
    assert _sources([], None) == ([], Path())


def test_wrong_arguments_are_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(click.UsageError, match=r"one folder of recordings; name one, as FOLDER or"):
        _sources([str(tmp_path)], tmp_path)
    with pytest.raises(Failure, match=r"there is no recording nowhere\.mtb; check the name"):
        _sources(["nowhere.mtb"], None)
    with pytest.raises(Failure, match=r"there is no recording nowhere\.mtb\.gz; check the name"):
        _sources(["nowhere.mtb.gz"], None)


def test_reports_of_the_folder_and_the_folders_in_it(tmp_path: Path) -> None:
    pytest.importorskip("nicegui", reason="the extra studio is not installed")
    from xbus.studio.server import _report

    folder = tmp_path / "recordings"
    (folder / "day").mkdir(parents=True)
    for path in (folder / "day" / "a.html", tmp_path / "secret.html", folder / "walk.mtb"):
        path.write_text("text")
    (folder / "link.html").symlink_to(tmp_path / "secret.html")
    assert _report(folder, "day/a.html") == (folder / "day" / "a.html").resolve()
    for name in ("../secret.html", "link.html", "walk.mtb", "day", "a\0.html", "a" * 5000, ""):
        assert _report(folder, name) is None
    assert _report(folder, str(tmp_path / "secret.html")) is None


def test_facts_are_read_once_for_two_pages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copy(WALK, tmp_path / "walk.mtb")
    (entry,) = find_recordings(tmp_path).entries
    runs = []
    plain = commands.run_command

    async def run(*words: str) -> str:
        runs.append(words)
        return await plain(*words)

    monkeypatch.setattr(commands, "run_command", run)
    small = commands.small_facts(entry)
    monkeypatch.setattr(commands, "SMALL", 0)

    async def two() -> list[commands.Facts]:
        return list(await asyncio.gather(commands.describe(entry), commands.describe(entry)))

    one, other = asyncio.run(two())
    assert one == other == small
    assert (one.samples, one.lost_samples, one.places) == (1040, 0, 0)
    assert "magnetic_field" in one.quantities
    assert len(runs) == 1
