"""A session over a link: carries commands out and answers back, and keeps what comes meanwhile."""

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
from xbus.device.timing import Timing
from xbus.errors import DecodeError, DeviceError, Disconnected, StateError, XbusTimeout
from xbus.protocol.tables import MESSAGES
from xbus.protocol.values import State
from xbus.wire.link import Link
from xbus.wire.strings import String

__all__ = ["Channel"]

#: Seconds to wait for the answer to a command, as the vendor's software does.
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
TIMEOUT_SLOW = 2.0
#: GoToConfig may be missed while the device sends a lot, or has just woken up: once in 0.2 s, for 2 s.
CONFIG_TRIES, CONFIG_TIMEOUT = 10, 0.2
#: Bytes that may wait in a device for the line, and bits of each on it.
BACKLOG, BITS = 4096, 10
#: How long to listen for a device before asking, and how long for its answer.
LISTEN, ANSWER = 0.25, 0.35
#: How long after WakeUp it takes until samples come, if nobody answers it: 0.5 s (section 4), and some more.
WAKING = 1.5
#: Silence after which what is incomplete counts as damage.
QUIET = 0.1
#: Between two tries to open a port that was lost.
PAUSE = 0.1
#: How long a thread waits at least for another one that takes in.
TURN = 0.01
#: Samples that are kept for who does not read them: as many as come in a minute at 4 Mbaud.
KEPT = 1_000_000
#: Strings that are kept for who does not read them.
KEPT_STRINGS = 100_000


class Channel:
    """Carries a session's commands over a link.

    Several threads may use it: one can wait for samples while another sends commands. Whoever takes bytes
    in keeps what the others wait for.

    Attributes:
        link: What carries the bytes.
        session: What is known of the device.
        samples: Samples that nobody has read, the oldest first.
        strings: Strings that nobody has read, the oldest first.
        notices: Messages that nobody asked for, the latest 100.
        lost_samples: Samples that nobody read before a million others came.
        lost_strings: Strings that nobody read before 100,000 others came.
        device_id: Device identifier, once it has been read.
        timing: The clocks by which samples tell their times.
    """

    def __init__(self, link: Link, session: Session, *, reconnect: bool = False) -> None:
        self.link = link
        self.session = session
        self.device_id: int | None = None
        self._reconnects = reconnect
        #: When the port was lost, and in which state the device was then; None once it is back.
        self._lost: tuple[float, State] | None = None
        self._is_coming_back = False
        self.samples: deque[Sample] = deque()
        self.strings: deque[String] = deque()
        self.notices: deque[Notice] = deque(maxlen=100)
        self.lost_samples = self.lost_strings = 0
        self.timing = Timing(link.epoch)
        if link.trouble is not None:
            self.notices.append(Notice("Port", link.trouble, b"", session.bid, None))
        #: Pieces that have been taken from the queue, and when each came.
        self._backlog: deque[tuple[bytes, float]] = deque()
        self._answers: deque[Reply | Refusal] = deque()
        self._heard_at = link.clock()
        self._is_broken = False
        self._taking_in = threading.Lock()
        self._commanding = threading.RLock()

    # Bytes

    @property
    def waiting_bytes(self) -> int:
        """Bytes that have been taken from the queue and not yet taken in."""
        return sum(len(piece) for piece, _ in self._backlog.copy())

    def receive(self, timeout: float, command: str | None = None) -> bool:
        """Takes in a piece of what has come, waiting for it no longer than so many seconds.

        Returns:
            Whether there was any, or another thread takes it in.
        """
        if not self._taking_in.acquire(timeout=max(timeout, TURN)):
            return True
        try:
            if not self._backlog:
                self._mend(command)
                try:
                    self._backlog.extend(self.link.read(timeout).pieces())
                except OSError as error:
                    self._lose(error, command)
            if self._backlog:
                # Piece by piece: what has waited for a minute is not to become a million objects at once.
                piece, self._heard_at = self._backlog.popleft()
                self._keep(self.session.receive(piece), self._heard_at)
                return True
            if self.link.clock() - self._heard_at >= QUIET:
                self._keep(self.session.quiet())
            return False
        finally:
            self._taking_in.release()

    def send(self, data: bytes, command: str) -> None:
        """Sends bytes."""
        self._mend(command)
        try:
            self.link.write(data)
        except OSError as error:
            self._lose(error, command)

    def _keep(self, events: Iterable[SessionEvent], arrival: float | None = None) -> None:
        for event in events:
            if isinstance(event, Sample):
                event.arrival, event.timing = arrival, self.timing
                if len(self.samples) >= KEPT:
                    self.samples.popleft()
                    self.lost_samples += 1
                self.samples.append(event)
            elif isinstance(event, String):
                if len(self.strings) >= KEPT_STRINGS:
                    self.strings.popleft()
                    self.lost_strings += 1
                self.strings.append(replace(event, arrival=arrival))
            elif isinstance(event, Notice):
                self.notices.append(event)
            else:
                self._answers.append(event)

    def _lose(self, error: OSError, command: str | None) -> NoReturn:
        self._keep(self.session.quiet())
        if self._lost is None:
            self._lost = self.link.clock(), self.session.state
        self.session.forget()
        self._is_broken = True
        what = f"while {command} was under way" if command else "while listening"
        raise Disconnected(
            f"{self.link.name} is gone, {what}: {error}; the next command tries to open it again",
            command,
        ) from error

    def _mend(self, command: str | None) -> None:
        """Opens the port again if it was lost."""
        if self._is_broken:
            try:
                self.link.reopen()
            except OSError as error:
                self._lose(error, command)
            self._is_broken = False
            if not self._is_coming_back:
                self._lost = None

    # Commands

    def command(self, name: str, value: Any) -> Reply:
        """Sends a command and waits for its answer: see `Device.command`."""
        with self._commanding:  # the answers of two would be mixed up
            return self._command(name, value)

    def _command(self, name: str, value: Any) -> Reply:
        if self.session.state == State.UNKNOWN and name not in ("GoToConfig", "Reset", PROBE):
            self.find_state()
        timeout, tries = self._patience(name)
        for _ in range(tries):
            frame = self.session.request(name, value)
            try:
                self.send(frame, name)
                if MESSAGES[name].reply is None:
                    return Reply(name, None, b"")
                if (answer := self._answer(name, timeout)) is not None:
                    break
            finally:
                self.session.abandon()  # after Ctrl-C, too: other commands would wait for ever
        else:
            waited = timeout * tries
            raise XbusTimeout(
                f"no answer to {name} from {self.link.name} within {waited:g} s; is the device powered, and"
                f" at {self.link.baudrate} baud?",
                name,
                waited,
            )
        if isinstance(answer, Refusal):
            raise answer.error
        return answer

    def _patience(self, name: str) -> tuple[float, int]:
        """How long to wait for an answer, and how often to ask."""
        # On a slow line that is full the answer comes behind all that waits in the device.
        full = self.link.is_line and self.session.state != State.CONFIG
        behind = BACKLOG * BITS / self.link.baudrate if full else 0.0
        if name == "GoToConfig":
            return CONFIG_TIMEOUT, CONFIG_TRIES + math.ceil(behind / CONFIG_TIMEOUT)
        known = self.session.support
        slow = known is None or known.product.series == "1-series"
        return TIMEOUTS.get(name, TIMEOUT_SLOW if slow else TIMEOUT) + behind, 1

    def _answer(self, name: str, timeout: float) -> Reply | Refusal | None:
        """The answer to the pending command, or None if there is none in time."""
        until = self.link.clock() + timeout
        while True:
            while self._answers:
                answer = self._answers.popleft()
                if answer.command == name:
                    return answer
            left = until - self.link.clock()
            is_there = self.receive(max(0.0, min(left, QUIET)), name)
            # It may stand behind much that has waited: what counts is when it came, not when it is read.
            if left <= 0 and (not is_there or self._heard_at > until):
                return None

    # The state

    def find_state(self) -> bool:
        """Finds out the state without changing it: listens, then asks. Whether anything was heard."""
        heard = self._listen(LISTEN)
        if self.session.state == State.WAKEUP:
            # It goes on by itself, to Measurement State or, if told so, to Config State.
            self.wait_for(lambda: self.session.state != State.WAKEUP, WAKING)
            if self.session.state == State.WAKEUP:
                self.session.forget()
        if self.session.state == State.UNKNOWN:
            self.send(self.session.request(PROBE), PROBE)
            answer = self._answer(PROBE, ANSWER)
            self.session.abandon()
            heard = heard or answer is not None or self.session.state != State.UNKNOWN
        return heard

    def find(self, baudrates: Iterable[int]) -> None:
        """Listens and asks at one baud rate after the other, and stays at the first where something is heard.

        Raises:
            XbusTimeout: Nothing was heard at any of them.
        """
        begun, tried = self.link.clock(), []
        for rate in baudrates:
            self.link.baudrate = rate
            if self.find_state():
                return
            tried.append(str(rate))
        raise XbusTimeout(
            f"nothing was heard on {self.link.name} at {', '.join(tried)} baud; is the device powered and"
            " connected, and does no other program (ModemManager?) use the port? restore_communication()"
            " brings back one that nobody can talk to",
            None,
            self.link.clock() - begun,
        )

    def _listen(self, seconds: float) -> bool:
        """Whether anything that makes sense comes within so many seconds."""
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
        """Takes in what comes until a condition holds; whether it does within so many seconds.

        Args:
            condition: Looked at after each piece.
            seconds: How long to wait.
            command: What it is for, in the text of errors.
            reopen: Whether the port may go away meanwhile and come again, as that of a device on USB does
                when it starts anew.
        """
        until = self.link.clock() + seconds
        while not condition():
            if (left := until - self.link.clock()) <= 0:
                return False
            try:
                self.receive(min(left, QUIET), command)
            except Disconnected:
                if self._reconnects and command is None:
                    self._come_back()
                    until = self.link.clock() + left
                elif reopen:
                    self.link.pause(min(left, PAUSE))
                else:
                    raise
        return True

    def _come_back(self) -> None:
        """Waits until the device is there again, and brings it into the state in which it was lost."""
        while not self.come_back():
            pass

    def come_back(self) -> bool:
        """Tries once whether the device is there again, and brings it into the state in which it was lost."""
        if self.link.acquisition.ended is not None and not self._is_broken:
            # Who reads the link without this channel has seen its end.
            with contextlib.suppress(Disconnected):
                self._lose(ConnectionResetError(self.link.acquisition.ended), None)
        lost_at, state = self._lost or (self.link.clock(), self.session.state)
        self.link.pause(PAUSE)
        self._is_coming_back = True  # lost again meanwhile, it is still to be as it was at first
        try:
            # Whatever goes wrong while it comes back, it is tried again.
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
            self._is_coming_back = False

    def wait_for_samples(self, count: int, timeout: float) -> None:
        """Waits until so many samples are there, and no longer than ``timeout`` seconds for the next one.

        Raises:
            StateError: The device is in Config State, where it sends none.
            XbusTimeout: None came in time.
        """
        while (there := len(self.samples)) < count:
            if self.session.state == State.CONFIG:
                self._refuse_config("read_sample")
            if not self.wait_for(partial(self._has_more, there), timeout):
                instead = "; it sends strings: read_string()" if self.strings else ""
                raise XbusTimeout(
                    f"no sample from {self.link.name} within {timeout:g} s{instead}", None, timeout
                )

    def _has_more(self, samples: int) -> bool:
        return len(self.samples) > samples or self.session.state == State.CONFIG

    def wait_for_strings(self, timeout: float, *, samples: bool = False) -> None:
        """Waits until there is a string, but no longer than ``timeout`` seconds.

        Args:
            timeout: How long.
            samples: Whether a sample will do as well.

        Raises:
            StateError: The device is in Config State, where it sends none.
            XbusTimeout: None came in time.
        """

        def is_there() -> bool:
            return bool(self.strings or (samples and self.samples))

        if not self.wait_for(lambda: is_there() or self.session.state == State.CONFIG, timeout):
            what = "nothing" if samples else "no string"
            raise XbusTimeout(f"{what} from {self.link.name} within {timeout:g} s", None, timeout)
        if not is_there():
            self._refuse_config("read_string")

    def _refuse_config(self, command: str) -> NoReturn:
        raise StateError(
            "the device is in Config State and measures nothing; go_to_measurement() changes that",
            command,
            self.session.state,
        )
