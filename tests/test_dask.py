"""Logs on a cluster: two workers, and files on an S3 server."""

from __future__ import annotations

import functools
import os
import random
import signal
import sys
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cloudpickle
import fsspec
import numpy as np
import pandas as pd
import pytest
from distributed import Client, LocalCluster
from pandas.testing import assert_frame_equal

import streams
import xbus
import xbus.dask
from conftest import OWN_CAPTURES
from doc_examples import blocks
from object_store import ObjectStore
from streams import mtdata2, packet, real
from test_docs import PAGE_OF_CLUSTERS
from xbus import XbusError
from xbus.log.arrivals import Arrivals

AHRS, GNSSINS = streams.ahrs(3000), streams.gnssins(2000)
WALK = OWN_CAPTURES / "walk.mtb"


@pytest.fixture(scope="module")
def client() -> Iterator[Client]:
    """Two worker processes with one thread each. They are the default of dask while they run."""
    with (
        LocalCluster(  # type: ignore[no-untyped-call]
            n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0", memory_limit=0
        ) as cluster,
        Client(cluster) as client,  # type: ignore[no-untyped-call]
    ):
        yield client


def read_logs(source: Any, **options: Any) -> Any:
    return xbus.dask.read_logs(source, **options)


def table(data: bytes, file: str, index: str | None = None) -> pd.DataFrame:
    """The DataFrame of a whole log, with the name of its file."""
    frame = xbus.read_log(data).to_pandas()
    frame["file"] = file
    return frame if index is None else frame.set_index(index)


def same(one: pd.DataFrame, other: pd.DataFrame) -> None:
    one = one.assign(file=one["file"].astype(object))
    other = other.assign(file=other["file"].astype(object))
    assert_frame_equal(one, other, check_exact=True)


# On the cluster


def test_objects_are_read_in_ranges(client: Client, store: ObjectStore) -> None:
    store.put("2026/a.mtb", AHRS)
    store.put("2026/b.mtb", AHRS[: 88 * 1000])
    store.put("2026/notes.txt", b"")
    frame = read_logs(
        "s3://bucket/2026/*.mtb",
        block_bytes=40_000,
        index=None,
        storage_options=store.options,
    )
    assert frame.npartitions == 7 + 3
    store.ranges.clear()
    found = frame.compute()
    size = store.bytes_requested("2026/a.mtb")
    assert len(AHRS) <= size <= len(AHRS) + 7 * 2**15  # of each part a little more
    expected = [
        table(AHRS, "s3://bucket/2026/a.mtb"),
        table(AHRS[:88_000], "s3://bucket/2026/b.mtb"),
    ]
    same(found.reset_index(drop=True), pd.concat(expected, ignore_index=True))


def test_a_worker_that_is_killed_changes_nothing(
    client: Client, store: ObjectStore, tmp_path: Path
) -> None:
    url = store.put("killed.mtb", AHRS)
    frame = read_logs(url, block_bytes=20_000, storage_options=store.options)
    workers = set(client.scheduler_info()["workers"])
    mean = frame.map_partitions(_die_once, str(tmp_path / "dead"), meta=frame._meta).mean(
        numeric_only=True
    )
    found = mean.compute()
    assert (tmp_path / "dead").exists()
    client.wait_for_workers(2)
    assert set(client.scheduler_info()["workers"]) != workers
    expected = frame.mean(numeric_only=True).compute()
    assert found.to_dict() == pytest.approx(expected.to_dict(), nan_ok=True)


def _die_once(frame: pd.DataFrame, path: str) -> pd.DataFrame:
    """Kills the worker half-way, the first time."""
    if frame["sample"].iloc[0] > 1500:
        try:
            os.close(os.open(path, os.O_CREAT | os.O_EXCL))
        except FileExistsError:
            return frame
        os.kill(os.getpid(), signal.SIGKILL)
    return frame


def test_missing_denied_and_changed_objects(client: Client, store: ObjectStore) -> None:
    read = functools.partial(read_logs, storage_options=store.options, block_bytes=50_000)
    with pytest.raises(FileNotFoundError, match=r"'s3://bucket/nowhere\.mtb'$"):
        read("s3://bucket/nowhere.mtb")
    with pytest.raises(FileNotFoundError, match=r"no file matches: 's3://bucket/none\*'$"):
        read("s3://bucket/none*")
    url = store.put("object.mtb", AHRS)
    frame = read(url)
    store.denied.add(store.path("object.mtb"))
    with pytest.raises(PermissionError, match=r"Permission denied: 's3://bucket/object\.mtb'$"):
        frame.compute()
    with pytest.raises(PermissionError, match=r"Permission denied: 's3://bucket/object\.mtb'$"):
        read(url)
    store.denied.clear()
    store.put("object.mtb", AHRS[::-1])
    with pytest.raises(XbusError, match=r"^s3://bucket/object\.mtb has changed since it was split"):
        frame.compute()


def test_a_worker_without_the_extra(client: Client) -> None:
    frame = read_logs(os.fspath(WALK), block_bytes=20_000)
    client.run(_set_module, "pyarrow", None)
    try:
        with pytest.raises(ImportError) as caught:
            frame["acceleration_x"].sum().compute()
    finally:
        client.run(_set_module, "pyarrow", "pyarrow.lib")
    assert (
        str(caught.value)
        == 'to read logs with dask, pyarrow is needed: pip install "xbus-mti[dask]"'
    )


def _set_module(name: str, other: str | None) -> None:
    """Makes a module impossible to import, or possible again."""
    if other is None:
        sys.modules["kept"] = sys.modules.get(name)  # type: ignore[assignment]
        sys.modules[name] = None  # type: ignore[assignment]
    else:
        sys.modules[name] = sys.modules.pop("kept")


# In this process


@pytest.fixture
def files(tmp_path: Path) -> tuple[str, str]:
    paths = str(tmp_path / "a.mtb"), str(tmp_path / "b.mtb")
    for path, data in zip(paths, (AHRS, GNSSINS), strict=True):
        Path(path).write_bytes(data)
    return paths


def test_many_columns_give_no_warning(tmp_path: Path) -> None:
    data = streams.random_log(random.Random(1), 600)
    path = tmp_path / "wide.mtb"
    path.write_bytes(data)
    found = read_logs(path, index=None).compute(scheduler="synchronous")
    expected = xbus.read_log(data).to_pandas()
    assert len(expected.columns) > 100
    assert_frame_equal(found.drop(columns="file"), expected, check_exact=True)
    assert set(found["file"]) == {str(path)}


def test_files_with_different_columns(files: tuple[str, str]) -> None:
    frame = read_logs(list(files), block_bytes=30_000, index=None)
    found = frame.compute(scheduler="sync").reset_index(drop=True)
    expected = pd.concat(
        [table(data, file) for data, file in zip((AHRS, GNSSINS), files, strict=True)],
        ignore_index=True,
    )
    expected = expected[[*expected.columns.drop("file"), "file"]]
    assert list(found.columns) == list(expected.columns)
    assert (found.dtypes == frame.dtypes).all()
    for name in expected.columns.drop("file"):
        one, other = (one[name].to_numpy("float64", na_value=np.nan) for one in (found, expected))
        assert one.tobytes() == other.tobytes(), name
    assert found["file"].tolist() == expected["file"].tolist()


def test_only_needed_quantities_are_decoded(
    files: tuple[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []
    read = xbus.LogPart.read

    def noted(part: xbus.LogPart, *, quantities: list[str] | None = None) -> xbus.Log:
        asked.append(quantities)
        return read(part, quantities=quantities)

    monkeypatch.setattr(xbus.LogPart, "read", noted)
    frame = read_logs(files[0], block_bytes=30_000)
    mean = frame["acceleration_x"].mean().compute(scheduler="sync")
    assert mean == pytest.approx(xbus.read_log(AHRS)["acceleration"].values[:, 0].mean(), rel=1e-6)
    assert frame.groupby("file", observed=True).size().compute(scheduler="sync").tolist() == [3000]
    assert len(asked) > 10
    assert all(one in (["acceleration"], []) for one in asked)


def times(*seconds: float) -> bytes:
    return b"".join(
        mtdata2(packet(0x1060, round(10_000 * second).to_bytes(4, "big"))) for second in seconds
    )


@pytest.mark.parametrize(
    ("logs", "index", "divisions"),
    [
        ([times(1, 2, 3, 4, 5)], "time", (1, 3, 5, 5)),
        ([times(1, 2, 3, 4)], "time", (1, 3, 4)),
        ([times(1, 2, 2, 3, 4, 5)], "time", (1, 4, 5)),
        ([times(1, 1, 1, 2)], "time", (1, 2)),
        ([times(1, 2) + 6 * streams.frame(0x11) + times(2, 3, 4, 5)], "time", (1, 4, 5)),
        ([times(*[1] * 20)], "time", None),  # ten parts, of which eight are joined
        ([times(1, 2, 3, 4), times(5, 6)], "time", (1, 3, 5, 6)),
        ([times(5, 6), times(1, 2, 3, 4)], "time", None),
        ([times(1, 3, 2, 4)], "time", None),
        ([times(1, 2) + mtdata2(packet(0x1020, bytes(2)))], "time", None),
        ([times(1, 2, 3)], None, None),
        ([times(1, 1, 1, 1, 1)], "sample", (0, 2, 4, 4)),
        ([times(1, 2), times(3, 4)], "sample", None),
        ([b""], "time", None),
        ([b""], "sample", None),
        ([times(1, 2), b"", times(3, 4)], "time", (1, 3, 4)),
    ],
)
def test_divisions(
    logs: list[bytes], index: str | None, divisions: tuple[float, ...] | None, tmp_path: Path
) -> None:
    paths = [tmp_path / f"{at}.mtb" for at in range(len(logs))]
    for path, data in zip(paths, logs, strict=True):
        path.write_bytes(data)
    frame = read_logs(paths, index=index, block_bytes=2 * len(times(1)) - 1)
    assert frame.known_divisions == (divisions is not None)
    assert divisions is None or frame.divisions == divisions
    found = frame.compute(scheduler="sync")
    expected = pd.concat(
        [table(data, str(path), index) for path, data in zip(paths, logs, strict=True) if data]
        or [table(b"", "").set_index(index)]
    )
    # A file without a column makes it nullable, as in read_logs.
    expected = expected.astype(found.dtypes.drop("file").to_dict())
    if index is None:
        found, expected = found.reset_index(drop=True), expected.reset_index(drop=True)
    same(found, expected)
    if divisions is not None:
        first = frame.loc[divisions[0] : divisions[1]].compute(scheduler="sync")
        same(first, expected.loc[divisions[0] : divisions[1]])


def test_times_that_do_not_ascend_join_no_parts(tmp_path: Path) -> None:
    """As in logs of GNSS receivers, whose samples come late. Their divisions are not known anyway."""
    (tmp_path / "log.mtb").write_bytes(times(1, 3, 2, 5, 4, 7, 6))
    frame = read_logs(tmp_path / "log.mtb", block_bytes=2 * len(times(1)) - 1)
    assert frame.npartitions == 4
    assert not frame.known_divisions


def test_a_partition_is_one_task() -> None:
    frame = read_logs(str(WALK), block_bytes=20_000)
    assert len(frame.__dask_graph__()) == frame.npartitions > 1


def test_joined_parts_keep_their_host_times(tmp_path: Path) -> None:
    """Parts whose times are equal at the ends become one partition."""
    data, path = times(1, *[2] * 6, 3, 4), tmp_path / "log.mtb"
    path.write_bytes(data)
    ends = np.arange(1, 10) * len(times(1))
    arrivals = Arrivals(ends, 10**18 + ends * 10**9, len(data))
    Path(f"{path}.times").write_bytes(b"".join(arrivals.blocks()))
    frame = read_logs(path, block_bytes=2 * len(times(1)) - 1)
    assert frame.divisions == (1, 4, 4)
    found = frame["host_time"].compute(scheduler="sync").tolist()
    expected = xbus.read_log(path).host_time
    assert np.isfinite(expected).all()
    assert found == expected.tolist()


def test_pieces_are_one_recording(tmp_path: Path) -> None:
    paths = [tmp_path / "night.mtb", tmp_path / "night-0001.mtb"]
    for path, data in zip(paths, (AHRS[:100_000], AHRS[100_000:]), strict=True):
        path.write_bytes(data)
    frame = read_logs([paths[::-1]], block_bytes=30_000, index=None)
    found = frame.compute(scheduler="sync").reset_index(drop=True)
    same(found, table(AHRS, str(paths[1])))


def test_patterns(tmp_path: Path) -> None:
    for name in ("b.mtb", "a.mtb", "c.txt"):
        (tmp_path / name).write_bytes(times(1))
    frame = read_logs([str(tmp_path / "*.mtb"), (tmp_path / "a.mtb").as_uri()])
    files = frame["file"].compute(scheduler="sync").tolist()
    assert files == [str(tmp_path / name) for name in ("a.mtb", "b.mtb")]


@pytest.mark.parametrize(
    ("source", "options", "kind", "message"),
    [
        (b"", {}, TypeError, "dask reads files and URLs by their names, not bytes"),
        ([b""], {}, TypeError, "dask reads files and URLs by their names, not bytes"),
        (WALK, {"index": "tme"}, ValueError, "no column has the name 'tme' of the index"),
        (WALK, {"block_bytes": 0}, ValueError, "block_bytes must be at least 1"),
        (WALK, {"bid": 9}, ValueError, "no samples"),
        ([], {}, ValueError, "at least one"),
    ],
)
def test_wrong_calls(
    source: Any, options: dict[str, Any], kind: type[Exception], message: str
) -> None:
    with pytest.raises(kind, match=message):
        read_logs(source, **options)


def test_columns_that_mean_different_things(tmp_path: Path) -> None:
    for name, data_id in (("a.mtb", 0x2010), ("b.mtb", 0x2014)):
        (tmp_path / name).write_bytes(mtdata2(real(data_id, 1, 0, 0, 0)))
    with pytest.raises(
        ValueError, match=r"quaternion_q0 is in ENU in .*a\.mtb but in NED in .*b\.mtb; read these"
    ):
        read_logs(str(tmp_path / "*.mtb"))


# Examples


@pytest.mark.parametrize("number", range(3))
def test_examples(
    number: int, client: Client, store: ObjectStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The `python` blocks of the page run, with this cluster and stand-ins for Ray and Spark."""
    block = blocks(PAGE_OF_CLUSTERS, "python")[number]
    for name in ("walk.mtb", "only/2026/walk.mtb"):
        store.put(name, WALK.read_bytes())
    monkeypatch.setitem(fsspec.config.conf, "s3", store.options)
    for name, module in stand_ins().items():
        monkeypatch.setitem(sys.modules, name, module)
    printed: list[Any] = []
    text = block.replace('{"anon": True}', repr(store.options))
    text = text.replace("2026/", "only/2026/")  # without the objects of other tests
    text = text.replace("tcp://scheduler:8786", client.scheduler_info()["address"])
    names: dict[str, Any] = {"print": printed.append}
    exec(text, names)  # noqa: S102
    if "client" in names:
        names["client"].close()
    values = xbus.read_log(WALK)["acceleration"].values
    if number == 0:
        assert printed[0].tolist() == pytest.approx(values.mean(axis=0, dtype=np.float64), abs=1e-5)
    else:
        assert printed == [pytest.approx((values**2).sum(), rel=1e-5)]


def stand_ins() -> dict[str, Any]:
    """Modules that run a function in this process, after they have pickled it and its argument."""

    def sent(value: Any) -> Any:
        return cloudpickle.loads(cloudpickle.dumps(value))

    def run(function: Any, argument: Any) -> Any:
        return sent(function)(sent(argument))

    ray = types.SimpleNamespace(
        remote=lambda function: types.SimpleNamespace(remote=lambda part: run(function, part)),
        get=list,
    )
    rdd = types.SimpleNamespace(
        map=lambda function: types.SimpleNamespace(sum=lambda: sums(function))
    )
    found: list[Any] = []

    def sums(function: Any) -> float:
        return float(sum(run(function, part) for part in found))

    def parallelize(parts: list[Any], count: int) -> Any:
        assert count == len(parts)
        found[:] = parts
        return rdd

    session = types.SimpleNamespace(sparkContext=types.SimpleNamespace(parallelize=parallelize))
    builder = types.SimpleNamespace(getOrCreate=lambda: session)
    sql = types.SimpleNamespace(SparkSession=types.SimpleNamespace(builder=builder))
    return {"ray": ray, "pyspark": types.SimpleNamespace(sql=sql), "pyspark.sql": sql}
