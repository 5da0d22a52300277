"""A device that the studio has open: its stream, its recent past, its recordings and its settings."""

from __future__ import annotations

import contextlib
import re
import sys
import threading
import time
from dataclasses import dataclass, field, fields
from datetime import datetime
from pathlib import Path

import numpy as np
import numpy.typing as npt

from xbus.device import Device, connect
from xbus.extras import require
from xbus.formatting import device_name
from xbus.log.identity import Identity
from xbus.log.log import Log
from xbus.protocol.products import product_of_code
from xbus.protocol.tables import QUANTITIES
from xbus.protocol.values import Output, State
from xbus.rtk import Caster
from xbus.sim import SimI2c, SimSpi, SimulatedDevice, serving
from xbus.sim.bus_link import bus_of
from xbus.sim.options import device_of
from xbus.sim.serve import STEP_TIME
from xbus.studio.device_settings import DeviceSettings
from xbus.studio.exchange import Exchange
from xbus.studio.history import History, Series
from xbus.studio.recording import StudioRecording
from xbus.studio.replaying import REPLAY, Replaying
from xbus.studio.track import Track
from xbus.studio.view import CasterForm, View
from xbus.watch.attitude import Attitude
from xbus.watch.corrections import Corrections
from xbus.watch.device_source import DeviceSource, new_file
from xbus.watch.model import Model
from xbus.watch.rate import Rate

__all__ = ["ATTITUDE", "SIMULATED", "TRACK", "TRACK_SPAN", "Station", "key_of"]

#: Prefix of the name of a virtual device.
SIMULATED = "sim:"
#: Duration of a block of samples, in seconds.
STEP = 0.05
#: Names of the series of heading, pitch and roll, and of metres east and north of the first position.
ATTITUDE, TRACK = "attitude", "track"
#: Seconds of the track to keep.
TRACK_SPAN = 3600.0


@dataclass
class _Watched(Model):
    """The state of the stream; its blocks go to the history too."""

    history: History = field(default_factory=History, repr=False)
    #: The recording that is replayed; its clock is that of all times.
    replaying: Replaying | None = None
    track: Track = field(default_factory=Track, repr=False)
    _attitudes: Series = field(
        default_factory=lambda: Series(ATTITUDE, "deg", Attitude._fields), repr=False
    )
    _positions: Series = field(
        default_factory=lambda: Series(
            TRACK, "m", ("east", "north"), span=TRACK_SPAN, is_path=True
        ),
        repr=False,
    )

    def add_block(self, block: Log, now: float) -> None:
        """Updates the state, and keeps the samples."""
        if self.replaying is None:
            received = time.time()
            times = self.history.times(block, received)
        else:
            times = self.replaying.times(block)
            now = received = self.replaying.now
        self.history.add_block(block, times)
        super().add_block(block, now)
        self._add_attitude(received)
        self._add_positions(block, times)

    def _add_attitude(self, received: float) -> None:
        if self.last_attitude is not None and self.last_attitude[1] == self.now:
            attitude = self.last_attitude[0]
            self.history.add_rows(self._attitudes, np.array([received]), np.array([attitude]))

    def _add_positions(self, block: Log, times: npt.NDArray[np.float64]) -> None:
        sent = [each.name for each in self.quantities.values() if not each.has_stopped(self.now)]
        sample, metres = self.track.add(block, sent)
        if len(sample):
            self.history.add_rows(self._positions, times[sample], metres)


class Station:
    """A device that stays open until it is closed, with or without a page.

    A thread reads the stream. Commands run in the thread that calls them; the device makes readers wait
    meanwhile.

    Args:
        source: A port as `xbus.connect` takes it, or ``sim:PRODUCT`` for a virtual device,
            with options as there, or ``replay:FILE`` for a recording.
        baudrate: Bits per second; None to try the usual rates.

    Attributes:
        replaying: The recording that it replays; None for other devices.
        view: What a page showed of it last; the next one begins with that.
        caster: What was entered for corrections.

    Raises:
        OSError: The port cannot be opened.
        ValueError: The name is not a port.
        XbusError: The device does not answer.
    """

    def __init__(self, source: str, baudrate: int | None = None) -> None:
        self.source = source
        self.key = key_of(source)
        self._resources = contextlib.ExitStack()
        with self._resources:
            port: str | SimI2c | SimSpi
            replaying = Replaying(source) if source.startswith(REPLAY) else None
            self.replaying = replaying
            match _virtual(source) if replaying is None else replaying.device:
                case None:
                    port = source
                case SimulatedDevice() as virtual:
                    # Windows has no pseudo-terminals, and a fast replay is too much for one.
                    tcp = sys.platform == "win32" or replaying is not None
                    port = self._resources.enter_context(
                        # A fast replay needs short steps.
                        serving(
                            virtual,
                            tcp=tcp,
                            speed=self._speed,
                            step=STEP / 2 if replaying is None else STEP_TIME,
                        )
                    )
                case bus:
                    port = bus
            self.exchange = Exchange()
            self.device: Device = self._resources.enter_context(connect(port, baudrate))
            self.device.trace(self.exchange)
            with self.device.configure():  # reads the identity
                if replaying is not None:
                    self.device.discard()  # the recording begins when the device measures again
            self.settings = DeviceSettings(
                self.device, self.exchange, check_baudrate=not self.is_virtual
            )
            self._source = DeviceSource(
                self.device,
                reconnect=True,
                restore=True,
                step=STEP,
                clock=None if replaying is None else lambda: replaying.now,
            )
            model = self._source.model()
            watched = {each.name: getattr(model, each.name) for each in fields(model)}
            self.model = _Watched(**watched, replaying=replaying)
            self.view = View()
            self.caster = CasterForm()
            self.byte_rate = Rate()
            self.recording: StudioRecording | None = None
            self.last_recording: StudioRecording | None = None
            self.corrections: Corrections | None = None
            self._forwarding = contextlib.ExitStack()
            self._changing_corrections = threading.Lock()
            self._stop, self._is_to_clear = threading.Event(), threading.Event()
            self._thread = threading.Thread(
                target=self._run, name=f"xbus studio {source}", daemon=True
            )
            self._thread.start()
            self._resources = self._resources.pop_all()

    @property
    def history(self) -> History:
        """The recent numbers."""
        return self.model.history

    @property
    def identity(self) -> Device | Identity:
        """Identifier, product code and firmware of the device, or of the one that was recorded."""
        return self.device if self.replaying is None else self.replaying.identity

    @property
    def title(self) -> str:
        """Product and identifier, as far as they are known, or else the port."""
        code, number = self.identity.product_code, self.identity.device_id
        product = self.device.product if self.replaying is None else product_of_code(code or "")
        name = product.name if product is not None else code and code.strip()
        known = [name, None if number is None else device_name(number)]
        other = self.source if self.replaying is None else "unknown product"
        return " ".join(part for part in known if part) or other

    @property
    def is_recording(self) -> bool:
        """Whether what arrives is recorded; not after an early end."""
        return self.recording is not None and self.recording.error is None

    @property
    def is_virtual(self) -> bool:
        """Whether the studio made the device."""
        return self.source.startswith((SIMULATED, REPLAY))

    @property
    def outputs(self) -> tuple[Output, ...] | None:
        """What the device is configured to send; None if that is not known.

        The samples of a replay are as they were configured at that time, which is not known.
        """
        return self.device.output_configuration if self.replaying is None else None

    def _speed(self) -> float:
        """Returns the seconds of a virtual device per second."""
        return 1.0 if self.replaying is None else self.replaying.speed

    def replay_from(self, seconds: float) -> None:
        """Replays the recording from a moment on, in seconds since its beginning.

        Raises:
            XbusError: The virtual device does not answer.
        """
        if self.replaying is not None:
            self.replaying.start_at(seconds)
            with self.device.configure():
                pass  # the recording begins when the device measures again
            self.measure()
            self._is_to_clear.set()

    def clear_counts(self) -> None:
        """Counts losses, damage and samples out of range from the next block on."""
        self._is_to_clear.set()
        self.model.add_event("the counts were cleared", is_bad=False)

    def _run(self) -> None:
        while not self._stop.is_set():
            if self._is_to_clear.is_set():
                self._is_to_clear.clear()
                self._source.clear_counts(self.model)
            self._source.advance(self.model)
            self.byte_rate.add(time.monotonic(), self._source.stats.bytes)
            recording = self.recording
            if recording is not None and recording.is_over:
                self.stop_recording()
            corrections = self.corrections  # another thread may end them meanwhile
            if corrections is not None:
                for text, is_bad in corrections.news():
                    self.model.add_event(text, is_bad=is_bad)

    def measure(self) -> None:
        """Makes a device in Config State measure.

        Raises:
            XbusError: It does not answer.
        """
        if self.device.state == State.CONFIG:
            self.device.go_to_measurement()

    def show_all(self, frequency: int = 100) -> None:
        """Makes a virtual device send what it measures, at most at a rate in Hz, and starts it.

        High-rate data and triggers, which come in other messages, are left out.
        """
        with self.device.configure() as device:
            support = device.support
            offered = (
                {} if support is None else {name: support.rates_of(name) for name in QUANTITIES}
            )
            rates = {
                name: max((rate for rate in rates if rate <= frequency), default=None)
                for name, rates in offered.items()
                if rates and not name.endswith("_hr") and not name.startswith("trigger")
            }
            # The port of a virtual device is not a serial line and has no baud rate.
            device.set_output_configuration(rates, check_baudrate=False)
        self.measure()

    def start_corrections(
        self, url: str, mountpoint: str, user: str = "", password: str = "", gga: int | None = None
    ) -> None:
        """Starts to forward corrections of a caster; they go on when the page is closed.

        Args:
            url: Address of the caster.
            mountpoint: Name of the stream.
            user: User name; empty for none.
            password: Password; empty for none.
            gga: Seconds between two positions of the device that the caster gets; None for none.

        Raises:
            ImportError: The extra ``rtk`` is not installed.
            ValueError: The address is none of a caster.
            XbusError: The caster or the device refuses.
        """
        require("pygnssutils", "rtk", "to get corrections from a caster")
        fix = self.model.fix
        caster = Caster(
            url,
            mountpoint,
            user=user or None,
            password=password or None,
            gga=gga,
            position=lambda: fix.position,
        )
        corrections = Corrections(caster, fix, persistent=True)
        with self._changing_corrections:
            self._end_corrections()
            self._forwarding.enter_context(corrections.forwarding(self.device))
            self.corrections = corrections

    def stop_corrections(self) -> None:
        """Ends the corrections, if there are any."""
        with self._changing_corrections:
            self._end_corrections()

    def _end_corrections(self) -> None:
        self.corrections = None
        self._forwarding.close()

    def start_recording(
        self,
        folder: Path,
        note: str = "",
        *,
        duration: float | None = None,
        rotate_bytes: int | None = None,
        rotate_seconds: float | None = None,
    ) -> StudioRecording:
        """Starts to record every byte to a new file in a folder.

        Args:
            folder: The folder; it is created if it does not exist.
            note: Text for the side file of notes; empty for none.
            duration: Seconds after which the recording stops; None for no limit.
            rotate_bytes: As for `Device.record`.
            rotate_seconds: As for `Device.record`.

        Raises:
            OSError: The file cannot be written.
            RuntimeError: The device is being recorded.
            XbusError: The device did not send its Configuration.
        """
        folder.mkdir(parents=True, exist_ok=True)
        path = new_file(folder, self.file_stem)
        try:
            recording = self.device.record(
                path, rotate_bytes=rotate_bytes, rotate_seconds=rotate_seconds
            )
        except BaseException:
            path.unlink(missing_ok=True)
            raise
        self.recording = StudioRecording(path, recording, duration)
        if note:
            self.recording.add_note(note)
        return self.recording

    @property
    def file_stem(self) -> str:
        """Product and time, for the name of a file."""
        code = self.identity.product_code or self.source
        product = re.sub(r"[^A-Za-z0-9-]+", "-", code.strip()).strip("-")
        return f"{product}-{datetime.now():%Y%m%d-%H%M%S}"

    def stop_recording(self) -> StudioRecording | None:
        """Stops the recording, and returns it; None if there is none."""
        recording, self.recording = self.recording, None
        if recording is not None:
            recording.stop()
            self.last_recording = recording
        return recording

    def close(self) -> StudioRecording | None:
        """Stops the recording, restores the initial state of the device and closes the port.

        Returns:
            The recording; None if there was none.
        """
        self._stop.set()
        self.stop_corrections()
        recording = self.stop_recording()
        self._source.close(self.model)
        self._resources.close()
        self._thread.join()
        return recording


def key_of(source: str) -> str:
    """Returns the name of a port for addresses of pages."""
    return re.sub(r"[^A-Za-z0-9]+", "-", source).strip("-")


def _virtual(source: str) -> SimulatedDevice | SimI2c | SimSpi | None:
    """Returns the virtual device of a name, or its bus; None if the name is that of a port.

    Raises:
        ValueError: There is no such product, bus or option.
    """
    if source.startswith(SIMULATED):
        return bus_of(source, live=True, noise=1) or device_of(source, noise=1)
    return None
