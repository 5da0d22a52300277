"""RTK corrections, which a thread forwards from a caster to a device."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

from xbus.errors import DeviceError, Disconnected, StateError, XbusError, XbusTimeout
from xbus.formatting import format_count

if TYPE_CHECKING:
    from xbus.device import Device

__all__ = ["Corrections"]

#: Maximum seconds to wait for a correction before the thread checks whether it must end.
READ_TIMEOUT = 0.2
#: Seconds until a caster that has refused is asked again.
REFUSED_PAUSE = 60.0
#: Seconds to wait for samples that have not arrived at the end of a block.
SAMPLE_TIMEOUT = 0.01
#: Maximum seconds for the thread to end: a command waits for its answer.
JOIN_TIMEOUT = 5.0


class Corrections:
    """Corrections from a caster, which a thread forwards to a device.

    Args:
        caster: A `xbus.rtk.Caster`.
        fix: The `xbus.rtk.Fix` that has the position for the caster.
        persistent: Whether to report errors and continue. Otherwise the first error ends the thread, and
            `read` raises it.

    Attributes:
        caster: The caster.
        fix: The fix.
        forwarder: Counts messages and bytes; None until the thread is started.
        refused: Number of corrections that the device refused.
    """

    def __init__(self, caster: Any, fix: Any, *, persistent: bool) -> None:
        self.caster, self.fix = caster, fix
        self.forwarder: Any = None
        self.refused = 0
        self._persistent = persistent
        self._error: Exception | None = None
        self._blocks: Any = None
        self._corrected_at: float | None = None
        self._stop = threading.Event()
        self._problems: SimpleQueue[str] = SimpleQueue()
        self._reported: set[str] = set()
        self._last_state, self._last_rtk = "idle", None

    @contextlib.contextmanager
    def forwarding(self, device: Device) -> Iterator[Corrections]:
        """Forwards corrections to a device for the length of a ``with`` block."""
        from xbus.rtk import Forwarder

        self.forwarder = Forwarder(device)
        thread = threading.Thread(target=self._run, args=(device,), name="xbus-rtk", daemon=True)
        thread.start()
        try:
            yield self
        finally:
            self._stop.set()
            self.caster.close()
            thread.join(JOIN_TIMEOUT)

    def _run(self, device: Device) -> None:
        while not self._stop.is_set():
            try:
                frame = self.caster.read(READ_TIMEOUT)
                # While the port is lost, a correction would be outdated before it is sent.
                if frame and (_measures(device) or not self._persistent):
                    self.forwarder.forward([frame])
                    self._corrected_at = time.monotonic()
            except XbusError as error:
                if not self._persistent:
                    self._error = error
                    return
                self._handle(error)
            except Exception as error:  # of the libraries that read from the caster
                self._error = error
                self._problems.put(f"corrections have ended: {error!r}")
                return

    def _handle(self, error: XbusError) -> None:
        """Reports an error, once, and waits if it is one of the caster."""
        from xbus.rtk import CasterError

        if isinstance(error, Disconnected | StateError):
            return  # the recording reports that the port is lost
        text = str(error)
        self.refused += isinstance(error, DeviceError)
        is_from_caster = isinstance(error, CasterError)
        if text not in self._reported:
            self._reported.add(text)
            again = f"; the next attempt follows in {REFUSED_PAUSE:.0f} s" if is_from_caster else ""
            self._problems.put(f"corrections: {text}{again}")
        if is_from_caster:
            self._stop.wait(REFUSED_PAUSE)

    def read(self, device: Device, seconds: float) -> None:
        """Waits, and updates the fix with the samples that arrive. Other readers must not read meanwhile.

        Raises:
            Disconnected: The port is gone.
            Exception: Forwarding has failed, and is not persistent.
        """
        if self._error is not None and not self._persistent:
            raise self._error
        if self._blocks is None:
            self._blocks = device.blocks(
                seconds=seconds, quantities=self.fix.QUANTITIES, timeout=SAMPLE_TIMEOUT
            )
        with contextlib.suppress(StateError, XbusTimeout):
            self.fix.update_from_block(next(self._blocks))

    @property
    def age(self) -> float | None:
        """Seconds since the last correction; None before the first."""
        return None if self._corrected_at is None else time.monotonic() - self._corrected_at

    def news(self) -> Iterator[tuple[str, bool]]:
        """Yields what has changed since the last call: a text, and whether it is a problem."""
        with contextlib.suppress(Empty):
            while True:
                yield self._problems.get_nowait(), True
        state, caster = self.caster.state, self.caster
        if state != self._last_state and state in ("streaming", "lost", "no position"):
            self._last_state = state
            if state == "streaming":
                yield f"corrections arrive from {caster.host}", False
            elif state == "lost":
                yield f"corrections: {caster.problem}; xbus connects again", True
            else:
                yield (
                    "corrections: the caster needs a position, and the device has no fix yet",
                    False,
                )
        if self.fix.rtk != self._last_rtk:
            self._last_rtk = self.fix.rtk
            yield f"RTK {self.fix.rtk}", False

    def describe_fix(self) -> str:
        """Returns the fix in words."""
        return f"fix {self.fix.type or 'unknown'}, RTK {self.fix.rtk or 'unknown'}"

    def describe_counts(self) -> str:
        """Returns what was forwarded, and the state of the caster if it does not stream."""
        forwarder, caster, age = self.forwarder, self.caster, self.age
        parts = [format_count(forwarder.messages, "message"), format_count(forwarder.bytes, "byte")]
        if age is not None:
            parts.append(f"last {age:.1f} s ago")
        if forwarder.unanswered:
            parts.append(f"{forwarder.unanswered} unanswered")
        if self.refused:
            parts.append(f"{self.refused} refused")
        if caster.gga_sent:
            parts.append(f"{caster.gga_sent} GGA")
        if caster.state != "streaming":
            parts.append(f"caster: {caster.problem or caster.state}")
        return ", ".join(parts)


def _measures(device: Device) -> bool:
    from xbus.protocol.values import State

    return device.link.acquisition.ended is None and device.state == State.MEASUREMENT
