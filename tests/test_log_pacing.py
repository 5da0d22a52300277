"""The pace of a replay."""

from __future__ import annotations

import numpy as np
import pytest

from conftest import OWN_CAPTURES, counter, fine
from streams import mtdata2
from xbus import iter_log, read_log
from xbus.log.pacing import UNSTAMPED_RATE, ReplayPace
from xbus.log.runs import steady_time


@pytest.mark.parametrize("name", ["walk.mtb", "field.mtb"])
@pytest.mark.parametrize("block_bytes", [100, 1000, 50_000])
def test_parts_have_the_pace_of_the_whole(name: str, block_bytes: int) -> None:
    path = OWN_CAPTURES / name
    log = read_log(path)
    whole = ReplayPace().times(log)
    pace = ReplayPace()
    parts = [pace.times(part) for part in iter_log(path, block_bytes=block_bytes)]
    times = np.concatenate(parts)
    assert np.all(np.diff(times) >= 0)
    stamped = np.isfinite(steady_time(log.core))
    assert times[stamped] == pytest.approx(whole[stamped])


def test_without_stamps_the_rate_is_that_of_most_products() -> None:
    log = read_log(b"".join(mtdata2(counter(row)) for row in range(50)))
    assert ReplayPace().times(log).tolist() == (np.arange(50) / UNSTAMPED_RATE).tolist()


def test_samples_without_a_stamp_are_due_between_their_neighbours() -> None:
    rows = [mtdata2(counter(0), fine(0)), mtdata2(counter(1)), mtdata2(counter(2), fine(4000))]
    log = read_log(b"".join(rows))
    assert ReplayPace().times(log).tolist() == pytest.approx([0.0, 0.2, 0.4])
