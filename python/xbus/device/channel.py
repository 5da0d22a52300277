"""A session over a link: sends commands, returns their answers, and queues samples meanwhile."""

from __future__ import annotations

import contextlib
import math
import threading
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from typing import Any, NoReturn

from xbus.device.events import Notice, Refusal, Reply, SessionEvent
from xbus.device.sample import Sample
from xbus.device.session import PROBE, Session
from xbus.device.timing import HostClocks
from xbus.errors import DecodeError, DeviceError, Disconnected, StateError, XbusTimeout
from xbus.protocol.tables import MESSAGES
from xbus.protocol.values import BITS_PER_BYTE, State
from xbus.wire.link import Link
from xbus.wire.strings import String

__all__ = ["Channel"]

#: Seconds to wait for the answer to a command, as the vendor's software has them.
TIMEOUTS = {
    "SetBaudrate": 1.0,
    "RestoreFactoryDef": 2.0,
    "RunSelftest": 3.0,
    "IccCommand": 3.5,
    "ReqConfiguration": 5.0,
    "ReqEmts": 10.0,
}
TIMEOUT = 0.5
#: The 1-series takes about 0.9 s to write a setting to its memory.
SLOW_TIMEOUT = 2.0
#: A device that sends a lot, or has just woken up, may miss GoToConfig: it is repeated every 0.2 s, for 2 s.
CONFIG_TRIES, CONFIG_TIMEOUT = 10, 0.2
#: Bytes that may wait in a device for the line.
DEVICE_BUFFER = 4096
#: Seconds to listen for a device before it is asked, and seconds to wait for its answer.
LISTEN_SECONDS, PROBE_SECONDS = 0.25, 0.35
#: Maximum seconds from an unanswered WakeUp to the first sample: 0.5 (section 4), and a margin.
WAKE_UP_SECONDS = 1.5
#: Seconds of silence after which an incomplete frame counts as damage.
SILENCE_SECONDS = 0.1
#: Seconds between two attempts to open a port that was lost.
REOPEN_INTERVAL = 0.1
#: Minimum seconds to wait for the thread that receives.
TURN_SECONDS = 0.01
#: Maximum number of unread samples: those of a minute at 4 Mbaud.
MAX_UNREAD_SAMPLES = 1_000_000
#: Maximum number of unread strings.
MAX_UNREAD_STRINGS = 100_000


class Channel:
    """Sends the commands of a session over a link, and queues what the device sends.

    Several threads may use a channel: one can wait for samples while another sends commands. The thread that
    receives bytes also queues what the others wait for.

    Attributes:
        link: The link.
        session: The session.
        samples: Unread samples, the oldest first.
        strings: Unread strings, the oldest first.
        notices: The latest 100 messages that answer no command.
        lost_samples: Samples dropped because a million newer ones were unread.
        lost_strings: Strings dropped because 100,000 newer ones were unread.
        device_id: Device identifier, once it is read.
    """

    def __init__(self, link: Link, session: Session, *, reconnect: bool = False) -> None:
        self.link = link
        self.session = session
        self.device_id: int | None = None
        self._reconnects = reconnect
        #: When the port was lost, and the state of the device then; None once it is back.
        self._lost: tuple[float, State] | None = None
        self._is_reconnecting = False
        self.samples: deque[Sample] = deque()
        self.strings: deque[String] = deque()
        self.notices: deque[Notice] = deque(maxlen=100)
        self.lost_samples = self.lost_strings = 0
        self._host_clocks = HostClocks(link.epoch)
        if link.trouble is not None:
            self.notices.append(Notice("Port", link.trouble, b"", session.bid, None))
        #: Pieces taken from the queue of the link, and the arrival of each.
        self._pieces: deque[tuple[bytes, float]] = deque()
        self._answers: deque[Reply | Refusal] = deque()
        self._heard_at = link.clock()
        self._is_disconnected = False
        self._receiving = threading.Lock()
        self._commanding = threading.RLock()

    # Bytes

    @property
    def waiting_bytes(self) -> int:
        """Bytes taken from the queue of the link that the session has not received yet."""
        return sum(len(piece) for piece, _ in self._pieces.copy())

    def receive(self, timeout: float, command: str | None = None) -> bool:
        """Receives one piece of bytes.

        Args:
            timeout: Seconds to wait for it.
            command: The command that waits, for error messages.

        Returns:
            Whether a piece was received, here or possibly by another thread.
        """
        if not self._receiving.acquire(timeout=max(timeout, TURN_SECONDS)):
            return True
        try:
            if not self._pieces:
                self._reopen(command)
                try:
                    self._pieces.extend(self.link.read(timeout).pieces())
                except OSError as error:
                    self._disconnect(error, command)
            if self._pieces:
                # One piece at a time: a minute of data would become a million objects at once.
                piece, self._heard_at = self._pieces.popleft()
                self._keep(self.session.receive(piece), self._heard_at)
                return True
            if self.link.clock() - self._heard_at >= SILENCE_SECONDS:
                self._keep(self.session.quiet())
            return False
        finally:
            self._receiving.release()

    def send(self, data: bytes, command: str) -> None:
        """Sends bytes."""
        self._reopen(command)
        try:
            self.link.write(data)
        except OSError as error:
            self._disconnect(error, command)

    def _keep(self, events: Iterable[SessionEvent], arrival: float | None = None) -> None:
        for event in events:
            if isinstance(event, Sample):
                event.arrival = arrival
                if len(self.samples) >= MAX_UNREAD_SAMPLES:
                    self.samples.popleft()
                    self.lost_samples += 1
                self.samples.append(event)
            elif isinstance(event, String):
                if len(self.strings) >= MAX_UNREAD_STRINGS:
                    self.strings.popleft()
                    self.lost_strings += 1
                self.strings.append(replace(event, arrival=arrival))
            elif isinstance(event, Notice):
                self.notices.append(event)
            else:
                self._answers.append(event)

    def take_sample(self) -> Sample:
        """Removes the oldest unread sample and returns it, with its host time.

        Raises:
            IndexError: All samples are read.
        """
        sample = self.samples.popleft()
        sample.host_time = self._host_clocks.host_time(sample)
        return sample

    def _disconnect(self, error: OSError, command: str | None) -> NoReturn:
        self._keep(self.session.quiet())
        if self._lost is None:
            self._lost = self.link.clock(), self.session.state
        self.session.forget()
        self._is_disconnected = True
        what = f"during {command}" if command else "while listening"
        raise Disconnected(
            f"{self.link.name} was lost {what}: {error}; check the cable; the next command opens the port"
            " again",
            command,
        ) from error

    def _reopen(self, command: str | None) -> None:
        """Opens the port again if it was lost."""
        if self._is_disconnected:
            try:
                self.link.reopen()
            except OSError as error:
                self._disconnect(error, command)
            self._is_disconnected = False
            if not self._is_reconnecting:
                self._lost = None

    # Commands

    def command(self, name: str, value: Any) -> Reply:
        """Sends a command and waits for its answer: see `Device.command`."""
        with self._commanding:  # one command at a time, so that answers are not mixed up
            return self._command(name, value)

    def _command(self, name: str, value: Any) -> Reply:
        if self.session.state == State.UNKNOWN and name not in ("GoToConfig", "Reset", PROBE):
            self.find_state()
        timeout, tries = self._timeout_and_tries(name)
        for _ in range(tries):
            frame = self.session.request(name, value)
            try:
                self.send(frame, name)
                if MESSAGES[name].reply is None:
                    return Reply(name, None, b"")
                if (answer := self._answer(name, timeout)) is not None:
                    break
            finally:
                self.session.abandon()  # also after Ctrl-C, or no other command could be sent
        else:
            waited = timeout * tries
            raise XbusTimeout(
                f"no answer to {name} from {self.link.name} within {waited:g} s; check that the device is"
                f" powered and uses {self.link.baudrate} baud",
                name,
                waited,
            )
        if isinstance(answer, Refusal):
            raise answer.error
        return answer

    def _timeout_and_tries(self, name: str) -> tuple[float, int]:
        """Returns how long to wait for an answer, in seconds, and how often to send the command."""
        # On a slow line that is full, the answer follows all bytes that wait in the device.
        full = self.link.is_line and self.session.state != State.CONFIG
        behind = DEVICE_BUFFER * BITS_PER_BYTE / self.link.baudrate if full else 0.0
        if name == "GoToConfig":
            return CONFIG_TIMEOUT, CONFIG_TRIES + math.ceil(behind / CONFIG_TIMEOUT)
        known = self.session.support
        slow = known is None or known.product.series == "1-series"
        return TIMEOUTS.get(name, SLOW_TIMEOUT if slow else TIMEOUT) + behind, 1

    def _answer(self, name: str, timeout: float) -> Reply | Refusal | None:
        """Returns the answer to the pending command, or None if there is none in time."""
        until = self.link.clock() + timeout
        while True:
            while self._answers:
                answer = self._answers.popleft()
                if answer.command == name:
                    return answer
            left = until - self.link.clock()
            has_received = self.receive(max(0.0, min(left, SILENCE_SECONDS)), name)
            # The answer may follow many queued bytes: its arrival counts, not when it is read.
            if left <= 0 and (not has_received or self._heard_at > until):
                return None

    # The state

    def find_state(self) -> bool:
        """Finds out the state without changing it: listens, then asks. Returns whether anything was heard."""
        heard = self._listen(LISTEN_SECONDS)
        if self.session.state == State.WAKEUP:
            # The device goes on to Measurement State or, if another program answers, to Config State.
            self.wait_for(lambda: self.session.state != State.WAKEUP, WAKE_UP_SECONDS)
            if self.session.state == State.WAKEUP:
                self.session.forget()
        if self.session.state == State.UNKNOWN:
            self.send(self.session.request(PROBE), PROBE)
            answer = self._answer(PROBE, PROBE_SECONDS)
            self.session.abandon()
            heard = heard or answer is not None or self.session.state != State.UNKNOWN
        return heard

    def find(self, baudrates: Iterable[int]) -> None:
        """Tries one baud rate after the other, and keeps the first at which it hears the device.

        Raises:
            XbusTimeout: Nothing was heard at any of them.
        """
        start, tried = self.link.clock(), []
        for rate in baudrates:
            self.link.baudrate = rate
            if self.find_state():
                return
            tried.append(str(rate))
        raise XbusTimeout(
            f"nothing was heard on {self.link.name} at {', '.join(tried)} baud; check that the device is"
            " powered and connected, and that no other program, such as ModemManager, uses the port;"
            " xbus restore recovers a device that answers at no baud rate",
            None,
            self.link.clock() - start,
        )

    def _listen(self, seconds: float) -> bool:
        """Returns whether a message or string comes within some seconds."""
        samples, notices = len(self.samples) + self.lost_samples, len(self.notices)
        return self.wait_for(
            lambda: (
                self.session.state != State.UNKNOWN
                or len(self.samples) + self.lost_samples > samples
                or len(self.notices) > notices
            ),
            seconds,
        )

    def wait_for(
        self,
        condition: Callable[[], bool],
        seconds: float,
        command: str | None = None,
        *,
        reopen: bool = False,
    ) -> bool:
        """Receives until a condition holds, and returns whether it does in time.

        Args:
            condition: Checked after each piece.
            seconds: How long to wait.
            command: The command that waits, for error messages.
            reopen: Whether the port may disappear and come back meanwhile, as that of a USB device does when
                it restarts.
        """
        until = self.link.clock() + seconds
        while not condition():
            if (left := until - self.link.clock()) <= 0:
                return False
            try:
                self.receive(min(left, SILENCE_SECONDS), command)
            except Disconnected:
                if self._reconnects and command is None:
                    self._reconnect()
                    until = self.link.clock() + left
                elif reopen:
                    self.link.pause(min(left, REOPEN_INTERVAL))
                else:
                    raise
        return True

    def _reconnect(self) -> None:
        """Waits until the device is back, and restores the state that it had."""
        while not self.try_reconnect():
            pass

    def try_reconnect(self) -> bool:
        """Tries once to reach the device and to restore the state that it had. Returns whether it is back."""
        if self.link.acquisition.ended is not None and not self._is_disconnected:
            # A reader that uses the link without this channel, such as a recording, has seen its end.
            with contextlib.suppress(Disconnected):
                self._disconnect(ConnectionResetError(self.link.acquisition.ended), None)
        lost_at, state = self._lost or (self.link.clock(), self.session.state)
        self.link.pause(REOPEN_INTERVAL)
        self._is_reconnecting = True  # a second loss keeps the state of the first
        try:
            # The caller tries again after a failure.
            with contextlib.suppress(Disconnected, XbusTimeout, DeviceError, DecodeError):
                self.command("GoToConfig", None)
                is_other = self.device_id not in (None, self.command("ReqDID", None).value)
                if is_other or state == State.MEASUREMENT:
                    self.command("GoToMeasurement", None)
                if not is_other:
                    gap = self.link.clock() - lost_at
                    self.notices.append(Notice("Reconnected", gap, b"", self.session.bid, None))
                    self._lost = None
                    return True
            return False
        finally:
            self._is_reconnecting = False

    def wait_for_samples(self, count: int, timeout: float) -> None:
        """Waits until some samples are unread.

        Args:
            count: How many.
            timeout: Seconds to wait for each.

        Raises:
            StateError: The device is in Config State, in which it sends no samples.
            XbusTimeout: No sample came in time.
        """
        while (unread := len(self.samples)) < count:
            if self.session.state == State.CONFIG:
                self._refuse_config("read_sample")
            if not self.wait_for(partial(self._has_more, unread), timeout):
                advice = (
                    "; the device sends strings, which read_string() returns"
                    if self.strings
                    else ""
                )
                raise XbusTimeout(
                    f"no sample from {self.link.name} within {timeout:g} s{advice}", None, timeout
                )

    def _has_more(self, samples: int) -> bool:
        return len(self.samples) > samples or self.session.state == State.CONFIG

    def wait_for_strings(self, timeout: float, *, samples: bool = False) -> None:
        """Waits until a string is unread.

        Args:
            timeout: Seconds to wait.
            samples: Whether an unread sample also ends the wait.

        Raises:
            StateError: The device is in Config State, in which it sends no strings.
            XbusTimeout: No string came in time.
        """

        def has_data() -> bool:
            return bool(self.strings or (samples and self.samples))

        if not self.wait_for(lambda: has_data() or self.session.state == State.CONFIG, timeout):
            what = "nothing" if samples else "no string"
            raise XbusTimeout(f"{what} from {self.link.name} within {timeout:g} s", None, timeout)
        if not has_data():
            self._refuse_config("read_string")

    def _refuse_config(self, command: str) -> NoReturn:
        raise StateError(
            "the device is in Config State and sends no data; go_to_measurement() starts it",
            command,
            self.session.state,
        )
