"""Files at URLs: read in ranges, their parts too; changes and errors name the file."""

from __future__ import annotations

import functools
import gzip
import http.server
import io
import pickle
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

import streams
import xbus
from conftest import differences, facts
from object_store import ObjectStore
from test_cli import run, sentence
from xbus import XbusError, split_log
from xbus.remote import MARGIN, MORE, RemoteFile, Url, matching_urls, remote_version

DATA = streams.dirty(4000)


def stored(store: ObjectStore, name: str, data: bytes = DATA) -> Url:
    return Url(store.put(name, data), store.options)


# A file


def test_a_file_is_read_in_growing_ranges(store: ObjectStore) -> None:
    data = bytes(range(256)) * 5000
    file = RemoteFile(stored(store, "plain", data))
    assert b"".join(iter(lambda: file.read(1000), b"")) == data
    assert file.tell() == len(data)
    ranges = store.ranges[store.path("plain")]
    assert ranges == ["bytes=0-262143", "bytes=262144-786431", "bytes=786432-1279999"]


def test_a_file_can_seek(store: ObjectStore) -> None:
    data = bytes(range(250)) * 10
    file, plain = RemoteFile(stored(store, "seek", data)), io.BytesIO(data)
    for offset, whence in ((100, 0), (5, 1), (-90, 1), (-3, 2), (0, 0), (3000, 0), (2499, 0)):
        assert file.seek(offset, whence) == plain.seek(offset, whence)
        assert file.read(7) == plain.read(7)
    file.seek(0)
    assert file.read() == data
    file.close()


def test_compressed_files(store: ObjectStore) -> None:
    assert xbus.read_log(stored(store, "log.mtb.gz", gzip.compress(DATA))) == xbus.read_log(DATA)


def test_a_url_keeps_its_options() -> None:
    url = pickle.loads(pickle.dumps(Url("s3://bucket/a", {"anon": True})))  # noqa: S301
    assert (url, url.storage_options) == ("s3://bucket/a", {"anon": True})


def test_patterns(store: ObjectStore) -> None:
    for name in ("2026/b.mtb", "2026/a.mtb", "2026/a.txt", "2025/a.mtb"):
        stored(store, name)
    urls = matching_urls(Url("s3://bucket/2026/*.mtb", store.options))
    assert urls == ["s3://bucket/2026/a.mtb", "s3://bucket/2026/b.mtb"]
    assert xbus.read_log(urls[0]) == xbus.read_log(DATA)
    assert matching_urls(Url("s3://bucket/2024/*.mtb", store.options)) == []
    assert matching_urls("s3://bucket/a?.mtb") == ["s3://bucket/a?.mtb"]


# Parts


def test_parts_request_only_their_ranges(store: ObjectStore) -> None:
    url = stored(store, "log.mtb")
    parts = split_log(url, block_bytes=70_000)
    assert len(parts) > 4
    read = []
    for part in parts:
        store.ranges.clear()
        read.append(pickle.loads(pickle.dumps(part)).read())  # noqa: S301
        assert store.bytes_requested("log.mtb") <= part.end - part.start + MARGIN + MORE
    assert differences(facts(*read), facts(xbus.read_log(DATA))) == []


def test_parts_are_read_by_several_threads(store: ObjectStore) -> None:
    parts = split_log(stored(store, "threads.mtb"), block_bytes=50_000)
    with ThreadPoolExecutor(4) as pool:
        read = list(pool.map(lambda part: part.read(), parts))
    assert differences(facts(*read), facts(xbus.read_log(DATA))) == []


def test_parts_of_pieces(store: ObjectStore) -> None:
    data = streams.ahrs(3000)
    cuts = [0, 90_011, 90_500, 180_000, len(data)]
    names = ["night.mtb", "night-0001.mtb", "night-0002.mtb", "night-0003.mtb"]
    urls = [
        stored(store, name, data[start:end])
        for name, start, end in zip(names, cuts, cuts[1:], strict=False)
    ]
    parts = split_log(urls[::-1], block_bytes=60_000)
    assert differences(facts(*(part.read() for part in parts)), facts(xbus.read_log(data))) == []
    store.ranges.clear()
    parts[-1].read()
    assert {path: len(ranges) for path, ranges in store.ranges.items()} == {store.path(names[3]): 1}
    stored(store, names[1], data[cuts[1] : cuts[2]][::-1])
    with pytest.raises(XbusError, match=r"^s3://bucket/night-0001\.mtb has changed since it was "):
        parts[-1].read()


# Changes


def test_an_object_that_changed_is_named(store: ObjectStore) -> None:
    parts = split_log(stored(store, "changed.mtb"), block_bytes=100_000)
    stored(store, "changed.mtb", DATA[::-1])
    with pytest.raises(
        XbusError,
        match=r"^s3://bucket/changed\.mtb has changed since it was split; split it again$",
    ):
        parts[2].read()


def test_the_same_bytes_again_are_no_change(store: ObjectStore) -> None:
    parts = split_log(stored(store, "same.mtb"), block_bytes=100_000)
    stored(store, "same.mtb")
    assert len(parts[2].read()) == parts[2].samples


def test_an_object_that_changes_while_it_is_read(store: ObjectStore) -> None:
    url = stored(store, "during.mtb", data := streams.ahrs(20_000))
    path = store.path("during.mtb")

    def change() -> None:
        if len(store.ranges[path]) == 2:
            store.before.pop(path)
            stored(store, "during.mtb", data[:-1])

    store.before[path] = change
    with pytest.raises(OSError, match=r"during\.mtb|no longer exists") as caught:
        xbus.read_log(url)
    assert caught.value.filename == url


def test_a_file_that_grows_while_it_is_split(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "log.mtb"
    path.write_bytes(DATA)
    opened = xbus.log.source.open_source

    def opened_and_grown(source: Any) -> object:
        result = opened(source)
        path.write_bytes(DATA + b"x")
        return result

    monkeypatch.setattr("xbus.log.parts.open_source", opened_and_grown)
    with pytest.raises(XbusError, match=r"log\.mtb changed while it was split; split it again"):
        split_log(path)


def test_versions(store: ObjectStore) -> None:
    url = stored(store, "version.mtb", b"1")
    first = remote_version(url)
    assert remote_version(url) == first
    stored(store, "version.mtb", b"2")
    assert remote_version(url) != first
    with pytest.raises(IsADirectoryError, match="s3://bucket"):
        remote_version(Url("s3://bucket", store.options))


# Errors


@pytest.mark.parametrize(
    ("url", "kind", "message"),
    [
        ("s3://bucket/none.mtb", FileNotFoundError, "No such file or directory: '{url}'"),
        ("s3://nowhere/none.mtb", FileNotFoundError, "the bucket does not exist: '{url}'"),
        ("s3://bucket/secret.mtb", PermissionError, "Permission denied: '{url}'"),
        ("{http}/bucket/none.mtb", FileNotFoundError, "No such file or directory: '{url}'"),
        ("{http}/bucket/secret.mtb", PermissionError, "Permission denied: '{url}'"),
        ("http://127.0.0.1:1/none.mtb", OSError, "'{url}'"),
        ("nothing://none.mtb", OSError, "Protocol not known: nothing: '{url}'"),
    ],
)
def test_errors_name_the_url(
    url: str, kind: type[OSError], message: str, store: ObjectStore
) -> None:
    store.denied.add(store.path("secret.mtb"))
    url = url.format(http=store.address)
    source = Url(url, store.options) if url.startswith("s3:") else url
    for read in (xbus.read_log, split_log, lambda source: xbus.read_log([source, source])):
        with pytest.raises(kind) as caught:
            read(source)
        assert caught.value.filename == url
        assert str(caught.value).endswith(message.format(url=url))
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("status", "code", "kind", "reason"),
    [
        ("403 Forbidden", "AccessDenied", PermissionError, "Permission denied"),
        (
            "403 Forbidden",
            "InvalidAccessKeyId",
            PermissionError,
            "the server does not know the access key",
        ),
        (
            "403 Forbidden",
            "SignatureDoesNotMatch",
            PermissionError,
            "the secret key is not that of the access key",
        ),
        ("400 Bad Request", "ExpiredToken", PermissionError, "the credentials have expired"),
        (
            "301 Moved Permanently",
            "PermanentRedirect",
            FileNotFoundError,
            "the bucket is in another region or at another endpoint",
        ),
    ],
)
def test_errors_of_s3_have_a_reason(
    status: str,
    code: str,
    kind: type[OSError],
    reason: str,
    store: ObjectStore,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    url = stored(store, f"{code}.mtb")
    parts = split_log(url, block_bytes=100_000)
    store.errors[store.path(f"{code}.mtb")] = status, code
    for read in (xbus.read_log, split_log, lambda _: parts[0].read()):
        with pytest.raises(kind) as caught:
            read(url)
        assert str(caught.value).endswith(f"{reason}: '{url}'")
    for name, value in store.environment.items():
        monkeypatch.setenv(name, value)
    result = run("info", url)
    assert sentence(result).startswith(f"cannot read {url}: {reason}; ")


def test_a_pattern_in_a_bucket_that_does_not_exist(store: ObjectStore) -> None:
    with pytest.raises(
        FileNotFoundError, match=r"the bucket does not exist: 's3://nowhere/\*\.mtb'"
    ):
        matching_urls(Url("s3://nowhere/*.mtb", store.options))


def test_an_object_that_is_refused_later(store: ObjectStore) -> None:
    parts = split_log(stored(store, "later.mtb"), block_bytes=100_000)
    store.denied.add(store.path("later.mtb"))
    with pytest.raises(PermissionError, match=r"Permission denied: 's3://bucket/later\.mtb'"):
        parts[0].read()


def test_a_missing_library(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gcsfs", None)
    with pytest.raises(ImportError) as caught:
        xbus.read_log("gs://bucket/log.mtb")
    assert str(caught.value).startswith("to read gs://bucket/log.mtb, a library is missing (")
    assert str(caught.value).endswith('): pip install "fsspec[gs]"')


# Web servers


def test_a_file_at_a_web_server_that_becomes_shorter(store: ObjectStore) -> None:
    stored(store, "shorter.mtb")
    file = RemoteFile(f"{store.address}/bucket/shorter.mtb")
    assert len(file.read(1 << 18)) == 1 << 18
    stored(store, "shorter.mtb", DATA[: 1 << 18])
    with pytest.raises(OSError, match=r"the file has become shorter .*: 'http://.*shorter\.mtb'"):
        file.read(1)


class WithoutRanges(http.server.SimpleHTTPRequestHandler):
    """Sends whole files only, as ``python -m http.server`` does."""

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def web(tmp_path: Path) -> Iterator[str]:
    handler = functools.partial(WithoutRanges, directory=str(tmp_path))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


def test_a_web_server_with_ranges(store: ObjectStore) -> None:
    stored(store, "web.mtb")
    url = f"{store.address}/bucket/web.mtb"
    assert xbus.read_log(url) == xbus.read_log(DATA)
    parts = split_log(url, block_bytes=100_000)
    assert differences(facts(*(part.read() for part in parts)), facts(xbus.read_log(DATA))) == []
    stored(store, "web.mtb", DATA[::-1])
    with pytest.raises(XbusError, match=r"web\.mtb has changed since it was split"):
        parts[0].read()


def test_a_web_server_without_ranges(web: str, tmp_path: Path) -> None:
    (tmp_path / "log.mtb").write_bytes(DATA)
    assert len(DATA) > 1 << 18  # more than the first request
    assert xbus.read_log(f"{web}/log.mtb") == xbus.read_log(DATA)
    with pytest.raises(OSError, match="the server does not send ranges of bytes; copy the file"):
        split_log(f"{web}/log.mtb")
    file, plain = RemoteFile(f"{web}/log.mtb"), io.BytesIO(DATA)
    for offset in (300_000, 5, 290_000, 299_000, len(DATA) + 1):
        assert file.seek(offset) == plain.seek(offset)
        assert file.read(10) == plain.read(10)


def test_storage_options(store: ObjectStore) -> None:
    """Every function that reads a log takes the options of the file system of a URL, and so do its parts."""
    url = store.put("options.mtb", DATA)
    options: dict[str, Any] = {"storage_options": store.options}
    log = xbus.read_log(DATA)
    assert xbus.read_log(url, **options) == xbus.read_log([url], **options) == log
    assert sum(map(len, xbus.iter_log(url, **options))) == len(log)
    part, *_ = pickle.loads(pickle.dumps(split_log(url, **options)))  # noqa: S301
    assert len(part.read()) == len(log)
    assert xbus.scan_log(url, **options).collect().height == len(log)
    assert xbus.log_batches(url, **options).read_all().num_rows == len(log)
