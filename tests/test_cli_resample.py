"""``xbus decode --rate-out``: the table that `Log.resample` has, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.feather
import pyarrow.parquet
import pytest

import xbus
from test_cli import FIELD, WALK, run, sentence
from xbus import encode_sample


@pytest.fixture(autouse=True)
def _empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("log", [WALK, FIELD], ids=["walk", "field"])
def test_the_table_is_that_of_resample(log: str) -> None:
    result = run("decode", log, "-o", "out.parquet", "--rate-out", "30")
    expected = xbus.read_log(log).resample(30).to_arrow()
    assert (result.exit_code, pyarrow.parquet.read_table("out.parquet")) == (0, expected)
    assert (
        f"out.parquet: {expected.num_rows:,} rows, {expected.num_columns} columns" in result.stderr
    )


def test_one_quantity() -> None:
    args = ["--rate-out", "30", "--quantity", "quaternion", "--max-gap", "0.005"]
    assert run("decode", WALK, "-o", "out.arrow", *args).exit_code == 0
    expected = xbus.read_log(WALK).resample(30, "quaternion", max_gap=0.005).to_arrow()
    assert expected["quaternion_q0"].null_count > 100
    assert pyarrow.feather.read_table("out.arrow").equals(expected)


def test_utc_is_a_column() -> None:
    args = ["--rate-out", "30", "--quantity", "quaternion", "--quantity", "utc_time"]
    assert run("decode", WALK, "-o", "out.arrow", *args).exit_code == 0
    table = pyarrow.feather.read_table("out.arrow")
    assert table.column_names[:3] == ["time", "utc", "quaternion_q0"]
    assert table["utc"].null_count == 0


def test_npz() -> None:
    assert run("decode", WALK, "-o", "out.npz", "--rate-out", "30", "-q").exit_code == 0
    with np.load("out.npz") as arrays:
        expected = xbus.read_log(WALK).resample(30)
        assert np.array_equal(arrays["acceleration"], expected["acceleration"])
        assert "packet_counter.unwrapped" not in arrays


@pytest.mark.parametrize(
    ("args", "text"),
    [
        (["--max-gap", "1"], "--max-gap needs --rate-out"),
        (["--rate-out", "0"], "--rate-out"),
        (["--rate-out", "inf"], "inf is not a finite number"),
        (["--rate-out", "10", "--quantity", "delta_v"], "delta_v has no values between samples"),
        (["--rate-out", "10", "--quantity", "HEHDT"], "HEHDT is a string"),
    ],
)
def test_wrong_calls(args: list[str], text: str) -> None:
    result = run("decode", WALK, "-o", "out.csv", *args)
    assert result.exit_code == 2
    assert text in result.stderr
    assert not list(Path().iterdir())


def test_a_log_without_time_stamps() -> None:
    Path("x.mtb").write_bytes(encode_sample({"temperature": 20.0}))
    result = run("decode", "x.mtb", "-o", "out.csv", "--rate-out", "10")
    assert "x.mtb has no time stamps; --rate HZ derives them" in sentence(result)
    assert not Path("out.csv").exists()
    counted = [encode_sample({"packet_counter": at, "temperature": at}) for at in range(5)]
    Path("x.mtb").write_bytes(b"".join(counted))
    assert (
        run("decode", "x.mtb", "-o", "out.csv", "--rate-out", "10", "--rate", "20").exit_code == 0
    )
    assert Path("out.csv").read_text().splitlines()[2].startswith("0.1,2")


def test_more_rows_than_can_be_meant() -> None:
    shown = sentence(run("decode", WALK, "-o", "out.csv", "--rate-out", "1e12"))
    assert (
        "rows would be made of 1,040 samples; choose a lower rate than 1e+12 Hz, or check" in shown
    )
    assert not list(Path().iterdir())
