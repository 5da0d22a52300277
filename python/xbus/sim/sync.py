"""The sync inputs of a virtual device: which edges act."""

from __future__ import annotations

from collections.abc import Sequence

from xbus.protocol.values import SYNC_OUT_FUNCTIONS, Polarity, SyncSetting
from xbus.sim.clock import SECOND

__all__ = ["SyncInputs", "delay_of", "reference_period"]

#: Units of a delay and of a clock period in a `SyncSetting`, in ns.
DELAY_UNIT, PERIOD_UNIT = SECOND // 10_000, SECOND // 1000
#: A reference clock may deviate by 1 / 200 of its period.
CLOCK_TOLERANCE = 200


def delay_of(setting: SyncSetting) -> int:
    """Returns the time in ns from the edge to the action of the device (Table 9)."""
    return setting.offset * DELAY_UNIT


def reference_period(setting: SyncSetting) -> int:
    """Returns the period in ns of the reference clock for clock bias estimation (Table 9)."""
    return setting.offset * PERIOD_UNIT


class SyncInputs:
    """Counts edges, from the time of the settings on (Table 9).

    Args:
        settings: Synchronization settings.
    """

    def __init__(self, settings: Sequence[SyncSetting]) -> None:
        self._inputs = [
            setting for setting in settings if setting.function not in SYNC_OUT_FUNCTIONS
        ]
        self._edges = [0] * len(self._inputs)
        self._reference: tuple[SyncSetting, int, bool] | None = None

    def edge(self, line: int, *, rising: bool) -> list[SyncSetting]:
        """Counts an edge, and returns the settings that it triggers."""
        triggered = []
        polarity = Polarity.RISING if rising else Polarity.FALLING
        for i, setting in enumerate(self._inputs):
            if setting.line != line or setting.polarity not in (polarity, Polarity.BOTH):
                continue
            count = self._edges[i] - setting.skip_first
            self._edges[i] += 1
            is_skipped = count < 0 or count % (setting.skip_factor + 1)
            if not is_skipped and not (setting.trigger_once and count):
                triggered.append(setting)
        return triggered

    def reference(self, setting: SyncSetting, now: int) -> None:
        """Records a pulse of the reference clock."""
        is_on_time = False
        if self._reference is not None:
            period = reference_period(setting)
            is_on_time = abs(now - self._reference[1] - period) <= period // CLOCK_TOLERANCE
        self._reference = setting, now, is_on_time

    def is_clock_synced(self, now: int) -> bool:
        """Returns whether a reference clock runs at the configured rate."""
        if self._reference is None:
            return False
        setting, last, is_on_time = self._reference
        return is_on_time and now - last < 2 * reference_period(setting)
