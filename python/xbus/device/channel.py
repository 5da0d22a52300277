"""A session over a link: sends commands, and waits for their answers and for data."""

from __future__ import annotations

import contextlib
import math
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NoReturn, Protocol

from xbus import _core
from xbus.describe.outputs import describe_outputs
from xbus.device.connection import Connection, abandon_in_fork
from xbus.device.events import Notice, Refusal, Reply
from xbus.device.session import PROBE, Session, changes_settings
from xbus.device.silence import nothing_heard
from xbus.device.stats import live_stats
from xbus.errors import (
    DecodeError,
    DeviceError,
    Disconnected,
    StateError,
    XbusError,
    XbusTimeout,
)
from xbus.log.identity import HEAD_MESSAGES, SETTINGS_MESSAGES, Identity, has_mtdata
from xbus.protocol.ids import MessageId
from xbus.protocol.products import product_of_code, support
from xbus.protocol.tables import MESSAGES
from xbus.protocol.values import BITS_PER_BYTE, State
from xbus.wire.codec import encode_frame, message_of
from xbus.wire.link import Link, line_rate

__all__ = ["Channel", "Trace"]

#: The commands whose acknowledgement changes the layout of MTData.
MTDATA_SETTINGS = ("SetOutputMode", "SetOutputSettings")
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
#: Seconds to listen for a device that cannot be asked; the lowest output rate is 1 Hz.
SLOWEST_SECONDS = 1.2
#: Maximum seconds from an unanswered WakeUp to the first sample: 0.5 (section 4), and a margin.
WAKE_UP_SECONDS = 1.5
#: Seconds of silence after which a command looks for its answer behind an incomplete frame.
SILENCE_SECONDS = 0.1
#: Seconds between two attempts to open a port that was lost.
REOPEN_INTERVAL = 0.1


class Trace(Protocol):
    """Follows the messages between host and device."""

    def sent(self, data: bytes) -> None:
        """Called with bytes that were sent."""

    def received(self, item: _core.ScannedFrame | _core.ScannedDamage) -> None:
        """Called with a message or damaged bytes that were received; not with samples and strings."""


class Channel:
    """Sends the commands of a session over a link, and waits for answers.

    Several threads may use a channel. Samples and strings stay in the queues of the link until they are read,
    so a reader does not delay a command, nor a command a reader.

    Attributes:
        link: The link.
        session: The session.
        is_listening: Whether nothing may be sent.
        notices: The latest 100 messages that answer no command.
        identity: What the device has sent about itself.
        heard: The last frame of each message about the device, by MID.
        meets_unknown_mtdata: Whether MTData has arrived whose settings are not known: see `learn_mtdata`.
        outdated: Number of samples and strings removed unread because new settings took effect.
        trace: Follows the messages, or None.
        connection: Opens, checks and closes the link.
        seen: Number of events that were ever handled.
    """

    def __init__(self, link: Link, *, listen: bool = False, reconnect: bool = False) -> None:
        self.link = link
        self.is_listening = listen
        #: The threads that configure the device, by call of `configuring`, and the state that is restored.
        self._configurers: dict[object, int] = {}
        self._found = State.UNKNOWN
        self.session = Session(bid=link.acquisition.bid)
        self.session.refusal = link.refusal
        self.identity = Identity()
        self.heard: dict[int, bytes] = {}
        self.outdated = 0
        self.meets_unknown_mtdata = self._has_asked_for_mtdata = False
        self.trace: Trace | None = None
        self.notices: deque[Notice] = deque(maxlen=100)
        if link.trouble is not None:
            self.notices.append(Notice("Port", link.trouble, b"", self.session.bid, None))
        self._reconnects = reconnect
        self._is_reconnecting = False
        #: When the port was lost, and the state of the device then; None once the device is back.
        self._lost: tuple[float, State] | None = None
        self._answers: deque[Reply | Refusal] = deque()
        self.seen = 0
        #: Number of messages, and first samples or strings after one.
        self._heard = 0
        #: Whether settings have changed since the last measurement began.
        self._has_new_settings = False
        self._make_locks()
        self.connection = Connection(link, self._note_loss)
        abandon_in_fork(self)

    def _make_locks(self) -> None:
        self._handling = threading.RLock()
        self._commanding = threading.RLock()
        self._reconnecting = threading.RLock()
        self._configuring = threading.RLock()

    def abandon(self) -> None:
        """Ends the channel in a forked process, in which no thread runs and locks may be held forever."""
        self._make_locks()
        self.connection.abandon()

    def _note_loss(self) -> None:
        """Handles what arrived before the port was lost; what the state is after that is not known."""
        self.handle_events()
        if self._lost is None:
            self._lost = self.link.clock(), self.session.state
        self.forget_state()

    def send(self, data: bytes, command: str) -> None:
        """Sends bytes.

        Raises:
            Disconnected: The port is gone, or was closed.
            StateError: The port was opened only to listen.
        """
        self.session.refuse(command)
        if self.is_listening:
            what = f"{command} was not sent: {self.link.name} was opened only to listen"
            raise StateError(what, command, self.state)
        losses = self._open(command)
        if self.trace is not None:
            self.trace.sent(data)
        self.connection.write(data, losses, command)

    def _open(self, command: str | None) -> int:
        """Opens the port again if it was lost. Returns how often that has happened.

        Raises:
            Disconnected: The port cannot be opened, or was closed.
        """
        losses = self.connection.open(command)
        if not self._is_reconnecting:
            self._lost = None
        return losses

    # Events

    @property
    def state(self) -> State:
        """The state of the device as of the last byte that arrived."""
        self.handle_events()
        return self.session.state

    def handle_events(self, *, early: bool = False) -> int:
        """Handles the messages that have arrived, and returns the number of events that were ever added.

        Args:
            early: Whether to look for messages also behind an incomplete frame, which may contain them.
        """
        with self._handling:
            events = self.link.acquisition.take_events(early=early)
            for item in events.items:
                self._handle(item)
            self.seen = events.added
            return events.added

    def _handle(self, item: _core.ScannedFrame | _core.ScannedDamage | None) -> None:
        self._heard += not isinstance(item, _core.ScannedDamage)
        if item is None:
            self.session.handle_data()
            return
        if self.trace is not None:
            self.trace.received(item)
        event = self.session.handle(item)
        if isinstance(item, _core.ScannedFrame) and item.mid in HEAD_MESSAGES:
            self._hear(item)
        if isinstance(event, Notice):
            if event.mid != MessageId.MTData:  # an output, which would replace all notices
                self.notices.append(event)
            elif not (self.is_listening or self._has_asked_for_mtdata):
                self.meets_unknown_mtdata = True
        elif isinstance(event, Reply | Refusal):
            self._answers.append(event)

    def _hear(self, frame: _core.ScannedFrame) -> None:
        """Remembers a message about the device."""
        if frame.mid == MessageId.Configuration and has_mtdata(frame.payload):
            for mid in SETTINGS_MESSAGES:  # from before
                self.heard.pop(mid, None)
        self.heard[frame.mid] = encode_frame(frame.mid, frame.payload, bid=frame.bid)
        self.identity = self.identity.updated([message_of(frame)])
        code = self.identity.product_code
        if self.is_listening and code is not None and (product := product_of_code(code)):
            self.session.identify(support(product, None))

    def forget_state(self) -> None:
        """Makes the state unknown, until something is heard."""
        self.session.forget()
        self.link.acquisition.mark_data()

    @contextlib.contextmanager
    def configuring(self) -> Iterator[None]:
        """Enters Config State; at the end restores the state in which the device was found.

        Several threads may configure a device at a time: the last one restores the state. Readers in other
        threads wait for that.
        """
        self.session.refuse("GoToConfig")
        call = object()
        try:
            with self._configuring:
                if not self._configurers:
                    if self.state == State.UNKNOWN:
                        self.find_state()
                    self._found = self.state
                self._configurers[call] = threading.get_ident()
                if self.state != State.CONFIG:
                    self.command("GoToConfig", None)
            yield
        except BaseException:
            # The error of the block matters more than a failure to restore the state.
            with contextlib.suppress(XbusError):
                self._end_configuring(call)
            raise
        else:
            self._end_configuring(call)
        finally:
            self._configurers.pop(call, None)  # also after Ctrl-C

    def _end_configuring(self, call: object) -> None:
        with self._configuring:
            try:
                if list(self._configurers) == [call]:
                    self._restore(self._found)
            finally:
                self._configurers.pop(call, None)

    def _restore(self, found: State) -> None:
        if found == State.MEASUREMENT and self.state != State.MEASUREMENT:
            if self.state != State.CONFIG:
                self.command("GoToConfig", None)
            self.command("GoToMeasurement", None)

    @property
    def sends_no_data(self) -> bool:
        """Whether the device is in Config State, and not only until other threads have configured it."""
        threads = self._configurers.values()
        will_measure = self._found == State.MEASUREMENT and bool(threads)
        is_waiting = will_measure and threading.get_ident() not in list(threads)
        return self.session.state == State.CONFIG and not is_waiting

    # Waiting

    def wait_for(
        self,
        condition: Callable[[], bool],
        seconds: float,
        command: str | None = None,
        *,
        reopen: bool = False,
        samples: int | None = None,
        strings: bool = False,
        cancel: _core.Cancel | None = None,
    ) -> bool:
        """Waits until a condition holds, and returns whether it does in time.

        Args:
            condition: Checked after each event, and when what the next arguments name has arrived.
            seconds: How long to wait.
            command: The command that waits, for error messages.
            reopen: Whether the port may disappear and come back meanwhile, as that of a USB device does when
                it restarts.
            samples: Check the condition when this number of samples is unread.
            strings: Check the condition when a string is unread.
            cancel: Ends the wait.

        Raises:
            Disconnected: The port is gone, or was closed.
        """
        until = self.link.clock() + seconds
        losses = None
        while True:
            seen = self.handle_events()
            if condition():
                return True
            if (left := until - self.link.clock()) <= 0 or (cancel is not None and cancel.is_set):
                return False
            try:
                losses = self._open(command) if losses is None else losses
                self.connection.check(losses, command)
                self.link.wait(left, samples=samples, strings=strings, events=seen, cancel=cancel)
            except Disconnected:
                losses = None
                if self.connection.is_closed:
                    raise
                if self._reconnects and command is None:
                    self._reconnect(cancel)
                    until = self.link.clock() + left
                elif reopen:
                    self.link.pause(min(left, REOPEN_INTERVAL))
                else:
                    raise

    def _reconnect(self, cancel: _core.Cancel | None) -> None:
        """Waits until the device is back, and restores the state that it had."""
        with self._reconnecting:
            while self.connection.is_lost or self._lost is not None:
                if self.try_reconnect() or (cancel is not None and cancel.is_set):
                    return

    def try_reconnect(self) -> bool:
        """Tries once to reach the device and to restore the state that it had. Returns whether it is back.

        Raises:
            Disconnected: The port was closed.
        """
        self.connection.refuse_closed(None)
        if not self.connection.is_lost:
            # A program that does not read, such as a recording, has seen the end.
            with contextlib.suppress(Disconnected):
                self.connection.check(self.connection.losses, None)
        lost_at, state = self._lost or (self.link.clock(), self.session.state)
        known_id = self.identity.device_id
        self.link.pause(REOPEN_INTERVAL)
        self._is_reconnecting = True  # a second loss keeps the state of the first
        try:
            if self.is_listening:
                return self._reopen_to_listen(lost_at)
            # The caller tries again after a failure.
            with contextlib.suppress(Disconnected, XbusTimeout, DeviceError, DecodeError):
                self.command("GoToConfig", None)
                is_other = known_id not in (None, self.command("ReqDID", None).value)
                if is_other or state == State.MEASUREMENT:
                    self.command("GoToMeasurement", None)
                if not is_other:
                    self._report_return(lost_at)
                    return True
            return False
        finally:
            self._is_reconnecting = False

    def _reopen_to_listen(self, lost_at: float) -> bool:
        with contextlib.suppress(Disconnected):
            self._open(None)
            self._report_return(lost_at)
            return True
        return False

    def _report_return(self, lost_at: float) -> None:
        gap = self.link.clock() - lost_at
        self.notices.append(Notice("Reconnected", gap, b"", self.session.bid, None))
        self._lost = None

    # Commands

    def command(self, name: str, value: Any) -> Reply:
        """Sends a command and waits for its answer: see `Device.command`."""
        with self._commanding:  # one command at a time, so that answers are not mixed up
            support = self.session.support
            if support is not None and name in support.legacy_messages:
                self._find_legacy_mode()
            reply = self._command(name, value)
            if changes_settings(name):
                self._has_new_settings = True
            if name == "GoToMeasurement":
                self.meets_unknown_mtdata = False  # MTData of before
            return reply

    def _find_legacy_mode(self) -> None:
        """Finds out whether a device of the 10- or 100-series sends MTData: it has no other output then."""
        if not self.session.is_in_legacy_mode and self.session.state == State.CONFIG:
            self._command("ReqOutputConfiguration", None)

    def learn_mtdata(self) -> None:
        """Asks for the settings of MTData; a measuring device enters Config State for a moment."""
        self.meets_unknown_mtdata, self._has_asked_for_mtdata = False, True
        with self.configuring(), contextlib.suppress(DeviceError, StateError):
            self.command("ReqOutputMode", None)
            self.command("ReqOutputSettings", None)

    def _command(self, name: str, value: Any) -> Reply:
        self.session.refuse(name)
        is_unknown = self.state == State.UNKNOWN and not self.is_listening
        if is_unknown and name not in ("GoToConfig", "Reset", PROBE):
            self.find_state()
        if name in ("GoToMeasurement", "Reset") and self._has_new_settings:
            # Samples of the next measurement must not follow those with the settings before.
            self.outdated += self.link.acquisition.clear_data()
            self._has_new_settings = False
        timeout, tries = self._timeout_and_tries(name)
        for _ in range(tries):
            frame = self.session.request(name, value)
            if name in MTDATA_SETTINGS:
                payload = self.session.validate(name, value)
                self.link.acquisition.note_request(self.session.bid, MESSAGES[name].mid, payload)
            try:
                self.send(frame, name)
                if MESSAGES[name].reply is None:
                    return Reply(name, None, b"")
                if (answer := self._answer(name, timeout)) is not None:
                    break
            finally:
                self._abandon()  # also after Ctrl-C, or no other command could be sent
        else:
            self._refuse_no_answer(name, timeout * tries)
        if isinstance(answer, Refusal):
            raise answer.error
        return answer

    def _refuse_no_answer(self, command: str, waited: float) -> NoReturn:
        port = self.link.name
        text = f"no answer to {command} from {port} within {waited:g} s"
        if command == "GoToConfig" and (outputs := self._outputs()):
            raise XbusTimeout(
                f"{text}, but the device sends {outputs}; check the line to the device, or restart it with"
                f" xbus reset {port}; xbus record --listen and xbus monitor --listen need no answer",
                command,
                waited,
            )
        advice = "check that the device is powered"
        if (rate := line_rate(self.link)) is not None:
            advice += f" and uses {rate} baud; xbus identify {port} finds its rate"
        raise XbusTimeout(f"{text}; {advice}", command, waited)

    def _abandon(self) -> None:
        with self._handling:
            self.session.abandon()
            # An answer that came too late would be taken for that of the next command with this name.
            self._answers.clear()
            if self.session.state == State.UNKNOWN:
                self.link.acquisition.mark_data()

    def _timeout_and_tries(self, name: str) -> tuple[float, int]:
        """Returns how long to wait for an answer, in seconds, and how often to send the command."""
        # On a slow line that is full, the answer follows all bytes that wait in the device.
        rate = None if self.session.state == State.CONFIG else line_rate(self.link)
        behind = 0.0 if rate is None else DEVICE_BUFFER * BITS_PER_BYTE / rate
        if name == "GoToConfig":
            return CONFIG_TIMEOUT, CONFIG_TRIES + math.ceil(behind / CONFIG_TIMEOUT)
        known = self.session.support
        slow = known is None or known.product.series == "1-series"
        return TIMEOUTS.get(name, SLOW_TIMEOUT if slow else TIMEOUT) + behind, 1

    def _answer(self, name: str, timeout: float) -> Reply | Refusal | None:
        """Returns the answer to the pending command, or None if there is none in time."""
        until, losses = self.link.clock() + timeout, self.connection.losses
        while True:
            now = self.link.clock()
            arrived = self.link.acquisition.waiting.last_arrival
            is_silent = arrived is not None and now - arrived >= SILENCE_SECONDS
            seen = self.handle_events(early=is_silent or now >= until)
            while self._answers:
                answer = self._answers.popleft()
                if answer.command == name:
                    return answer
            if now >= until:
                return None
            self.connection.check(losses, name)
            self.link.wait(min(until - now, SILENCE_SECONDS), events=seen)

    # The state

    def find_state(self) -> bool:
        """Finds out the state without changing it: listens, then asks. Returns whether anything was heard.

        Nothing is sent if the port was opened only to listen.
        """
        # A wait for a command does not reconnect: a thread that reconnects waits for this lock.
        command = None if self.is_listening else PROBE
        with self._commanding:
            before = self._heard
            self._listen(SLOWEST_SECONDS if self.is_listening else LISTEN_SECONDS, command)
            if self.session.state == State.WAKEUP:
                # The device goes on to Measurement State or, if another program answers, to Config State.
                self.wait_for(lambda: self.session.state != State.WAKEUP, WAKE_UP_SECONDS, command)
                if self.session.state == State.WAKEUP:
                    self.forget_state()
            if self.session.state == State.UNKNOWN and not self.is_listening:
                try:
                    self.send(self.session.request(PROBE), PROBE)
                    self._answer(PROBE, PROBE_SECONDS)
                finally:
                    self._abandon()
            return self._heard > before

    def find(self, baudrates: Iterable[int | None], *, restart: bool = False) -> None:
        """Tries one baud rate after the other, and keeps the first at which it hears the device.

        Args:
            baudrates: The rates, in bits per second; None for a port that has none.
            restart: Whether what was received at the rates before is noise that need not be counted.

        Raises:
            XbusTimeout: Nothing was heard at any of them.
        """
        start = self.link.clock()
        received: dict[int | None, int] = {}
        for rate in baudrates:
            self.link.baudrate = rate
            if restart and received:
                self.link.restart()
            before = self._received_bytes()
            if self.find_state():
                return
            received[rate] = self._received_bytes() - before
        text = nothing_heard(
            self.link.name,
            received,
            is_line=self.link.is_line,
            is_listening=self.is_listening,
        )
        raise XbusTimeout(text, None, self.link.clock() - start)

    def _received_bytes(self) -> int:
        return int(self.link.acquisition.stats(self.link.clock())["counts"]["bytes"])

    def _outputs(self) -> str:
        """Returns what the device sends now, in words; an empty string if that is nothing."""
        stats = live_stats(self.link.acquisition.stats(self.link.clock()), self.outdated)
        return describe_outputs(stats.rates, stats.message_rates)

    def _listen(self, seconds: float, command: str | None) -> None:
        """Waits until a message, sample or string comes, or the state is known."""
        before = self._heard
        self.link.acquisition.mark_data()
        self.wait_for(
            lambda: self.session.state != State.UNKNOWN or self._heard > before, seconds, command
        )
