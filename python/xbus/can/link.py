"""A CAN bus as the link to the devices on it. It is read only."""

from __future__ import annotations

import os
import threading
import time
import weakref
from typing import Any, Unpack

import numpy as np

from xbus import _core
from xbus.can.address import CanAddress, open_bus
from xbus.can.captures import FrameArrays
from xbus.can.findings import findings, unknown_ids
from xbus.can.ids import core_entries, device_ids
from xbus.can.recorder import CanRecorder
from xbus.can.traffic import Devices, Tally, Verdict
from xbus.errors import XbusTimeout
from xbus.formatting import format_count
from xbus.wire.link import Need

__all__ = ["CanLink"]

#: Seconds to wait for a frame before the thread looks whether the bus was closed.
READ_TIMEOUT = 0.05
#: Maximum number of frames that are passed on together.
MAX_FRAMES = 1 << 9
#: Seconds within which the thread ends after the bus was closed.
JOIN_TIMEOUT = 1.0
#: Seconds to listen for a device; the lowest output rate is 1 Hz.
LISTEN_SECONDS = 1.2
#: Seconds by which a good time stamp of an interface differs at most from the clock of this computer.
GOOD_STAMP = 2.0


class CanLink:
    """A `xbus.wire.link.Link` to the MTi-600 devices on a CAN bus, through python-can. A thread reads.

    Args:
        address: Where the bus is, and which devices are on it.
        bid: The device whose samples are handed out, from 1; 0xFF for all.
        bound: Maximum number of bytes of samples that wait to be read.

    Raises:
        ImportError: The extra ``can`` is not installed.
        OSError: The bus cannot be opened.
        ValueError: There is no such interface.
    """

    is_line = False
    trouble = None
    refusal = (
        "an MTi-600 sends on CAN, and cannot be configured over it; connect to its serial port, where "
        "set_can_output_configuration() sets what it sends on CAN (xbus config does it too)"
    )

    def __init__(self, address: CanAddress, *, bid: int = 0xFF, bound: int = 24_000_000) -> None:
        self.name = address.name
        self.baudrate: int | None = address.bitrate
        self._address = address
        self._devices = Devices(device_ids(address.ids))
        self.acquisition = _core.Acquisition.can(
            core_entries(self._devices.devices), rate=address.rate, bid=bid, bound=bound
        )
        self._open()

    def _open(self) -> None:
        bus = open_bus(self._address)
        self._pump = _Pump(bus, self.acquisition, Tally(self._devices))
        # A link that is dropped without `close` does not keep bus and thread: neither refers to it.
        self._finalizer = weakref.finalize(self, self._pump.close)

    def wait_for_device(self) -> None:
        """Waits up to `LISTEN_SECONDS` for a frame of a device.

        Raises:
            XbusTimeout: None came; the message says what did.
        """
        if self._pump.heard.wait(LISTEN_SECONDS) or self.acquisition.ended is not None:
            return
        with self._pump.lock:
            seen = self._pump.tally
            errors = seen.total(Verdict.ERROR)
            advice = " and ".join(unknown_ids(seen))
        if errors:
            advice = (
                f"{format_count(errors, 'error frame')}: probably the bit rate of the bus is not "
                f"{self.baudrate:,}, or a termination is missing (120 ohm at both ends)"
            )
        text = advice or (
            "check that CAN is switched on in the device (set_can_output_configuration() on its serial "
            f"port), the wiring, and that the bus has {self.baudrate:,} bit/s"
        )
        raise XbusTimeout(
            f"no frame of an MTi on {self.name} within {LISTEN_SECONDS} s; {text}",
            None,
            LISTEN_SECONDS,
        )

    @property
    def findings(self) -> tuple[str, ...]:
        """Sentences that say what is unusual on the bus, and what to do."""
        with self._pump.lock:
            return tuple(findings(self._pump.tally))

    def record(self, path: str | os.PathLike[str], **options: Any) -> CanRecorder:
        """Starts to record all frames: see `CanRecorder`.

        Raises:
            RuntimeError: The bus is already being recorded.
        """
        if self._pump.recorder is not None and self._pump.recorder.state["active"]:
            raise RuntimeError(f"{self.name} is already being recorded")
        recorder = CanRecorder(path, self._devices, self._pump.passing, **options)
        self._pump.recorder = recorder
        return recorder

    def wait(self, timeout: float, **need: Unpack[Need]) -> bool:
        """Waits up to ``timeout`` seconds: see `_core.Acquisition.wait`."""
        return self.acquisition.wait(timeout, **need)

    def write(self, data: bytes) -> None:
        """Raises an error: an MTi-600 does not listen to CAN."""
        raise OSError(f"{len(data)} bytes were not sent: {self.refusal}")

    def clock(self) -> float:
        """Returns the time in seconds on the clock of arrivals."""
        return time.monotonic()

    def pause(self, seconds: float) -> None:
        """Waits."""
        time.sleep(seconds)

    def restart(self) -> None:
        """Does nothing: no noise is received."""

    def reopen(self) -> None:
        """Opens the bus again. Queue, counts and recording continue."""
        before = self._pump
        self.acquisition.end("the bus is opened again")
        self._finalizer()
        self.acquisition.resume()
        try:
            self._open()
        except BaseException as error:
            self.acquisition.end(str(error))
            raise
        self._pump.tally, self._pump.recorder = before.tally, before.recorder

    def close(self) -> None:
        """Closes the bus, and ends the recording."""
        self.acquisition.close()
        self._finalizer()
        if self._pump.recorder is not None:
            self._pump.recorder.stop()

    def abandon(self) -> None:
        """Gives up the bus without a trace, in a forked process: it belongs to the parent."""
        self._finalizer.detach()


class _Pump:
    """A thread that reads a bus until the bus or the acquisition ends."""

    def __init__(self, bus: Any, acquisition: _core.Acquisition, tally: Tally) -> None:
        self._bus, self._acquisition, self.tally = bus, acquisition, tally
        self.lock, self.heard = threading.Lock(), threading.Event()
        self.passing = threading.Lock()
        self.recorder: CanRecorder | None = None
        self._is_closed = False
        #: Whether the time stamps of the interface are those of this computer; None before the first frame.
        self._has_good_stamps: bool | None = None
        self._thread = threading.Thread(
            target=self._run, name=f"xbus {bus.channel_info}", daemon=True
        )
        self._thread.start()

    def _run(self) -> None:
        try:
            while not self._is_closed and self._acquisition.ended is None:
                if messages := self._read():
                    self._pass_on(messages)
        except Exception as error:  # of any interface
            self._acquisition.end(f"the bus cannot be read: {error or type(error).__name__}")

    def _read(self) -> list[Any]:
        """Returns the frames that have arrived, after a wait for the first one."""
        messages: list[Any] = []
        timeout = READ_TIMEOUT
        while len(messages) < MAX_FRAMES and (message := self._bus.recv(timeout)) is not None:
            messages.append(self._stamped(message))
            timeout = 0.0
        return messages

    def _stamped(self, message: Any) -> Any:
        """Returns a message with a good time stamp."""
        if not self._has_good_stamps:
            now = time.time()
            if self._has_good_stamps is None:
                self._has_good_stamps = abs(message.timestamp - now) < GOOD_STAMP
            if not self._has_good_stamps:
                message.timestamp = now
        return message

    def _pass_on(self, messages: list[Any]) -> None:
        arrays = FrameArrays({})
        for message in messages:
            arrays.add(message)
        frames = arrays.frames()
        with self.passing:
            pushed = self._acquisition.push_can(frames.time, frames.ids, frames.sizes, frames.data)
            if pushed is None:
                return
            verdicts, samples = pushed
            if (recorder := self.recorder) is not None:
                recorder.add(messages, samples)
        with self.lock:
            self.tally.add(frames, verdicts)
        if not self.heard.is_set() and np.any(verdicts <= Verdict.EVENT):
            self.heard.set()

    def close(self) -> None:
        """Closes the bus, after the thread has ended."""
        if self._is_closed:
            return
        self._is_closed = True
        if self._thread is not threading.current_thread():
            self._thread.join(JOIN_TIMEOUT)
        self._bus.shutdown()
