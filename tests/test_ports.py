"""What the system says about ports."""

from __future__ import annotations

from pathlib import Path

import pytest

from xbus import connect
from xbus.device import ports
from xbus.sim import SimulatedDevice, serving

TIMERS = [
    ("16\n", "holds bytes back for 16 ms"),
    ("2\n", "holds bytes back for 2 ms"),
    ("1\n", None),
    ("", None),
]


@pytest.mark.parametrize(("timer", "says"), TIMERS)
def test_a_slow_adapter_is_reported_with_the_cure(
    timer: str, says: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sim = SimulatedDevice("MTi-630")
    sim.advance(1)
    with serving(sim) as port:
        folder = tmp_path / Path(port).name
        folder.mkdir()
        (folder / "latency_timer").write_text(timer)
        monkeypatch.setattr(ports, "SYSFS", tmp_path)
        with connect(port) as device:
            troubles = [notice.value for notice in device.notices if notice.name == "Port"]
    assert len(troubles) == (says is not None)
    if says is not None:
        assert says in troubles[0]
        assert "latency_timer" in troubles[0]


def test_a_port_without_a_timer() -> None:
    assert ports.latency_timer("/dev/null") is None
