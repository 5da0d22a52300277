"""Edges at the sync inputs of a virtual device: which of them count."""

from __future__ import annotations

from collections.abc import Sequence

from xbus.protocol.values import SYNC_OUT_FUNCTIONS, Polarity, SyncSetting

__all__ = ["SyncInputs", "delay_of", "reference_period"]

#: A reference clock may be off by one part in so many.
CLOCK_TOLERANCE = 200


def delay_of(setting: SyncSetting) -> int:
    """How long after the edge the device acts (Table 9), in ns."""
    return setting.offset * 100_000


def reference_period(setting: SyncSetting) -> int:
    """The period of the reference clock for clock bias estimation (Table 9), in ns."""
    return setting.offset * 1_000_000


class SyncInputs:
    """Counts the edges since the settings were made (Table 9).

    Args:
        settings: Synchronization settings.
    """

    def __init__(self, settings: Sequence[SyncSetting]) -> None:
        self._settings = [it for it in settings if it.function not in SYNC_OUT_FUNCTIONS]
        self._edges = [0] * len(self._settings)
        self._reference: tuple[SyncSetting, int, bool] | None = None

    def edge(self, line: int, *, rising: bool) -> list[SyncSetting]:
        """The settings for which this edge counts."""
        counting = []
        edge = Polarity.RISING if rising else Polarity.FALLING
        for i, it in enumerate(self._settings):
            if it.line != line or it.polarity not in (edge, Polarity.BOTH):
                continue
            after = self._edges[i] - it.skip_first
            self._edges[i] += 1
            if after < 0 or after % (it.skip_factor + 1) or (it.trigger_once and after):
                continue
            counting.append(it)
        return counting

    def reference(self, setting: SyncSetting, now: int) -> None:
        """A pulse of the reference clock."""
        in_time = False
        if self._reference is not None:
            period = reference_period(setting)
            in_time = abs(now - self._reference[1] - period) <= period // CLOCK_TOLERANCE
        self._reference = setting, now, in_time

    def is_clock_synced(self, now: int) -> bool:
        """Whether a reference clock goes at the rate that was set."""
        if self._reference is None:
            return False
        setting, last, in_time = self._reference
        return in_time and now - last < 2 * reference_period(setting)
