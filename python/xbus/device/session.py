"""The protocol without a port, clock or thread: bytes in, events out; commands in, bytes out."""

from __future__ import annotations

from typing import Any

from xbus import _core
from xbus.device.checks import check
from xbus.device.events import Notice, Refusal, Reply, SessionEvent
from xbus.device.sample import Sample
from xbus.errors import DecodeError, DeviceError, StateError
from xbus.protocol.ids import MessageId
from xbus.protocol.messages import LAYOUTS, decode, encode
from xbus.protocol.products import Support
from xbus.protocol.tables import MESSAGES, PRODUCTS, RESULT_CODES, MessageRow, message_name
from xbus.protocol.values import DeviceErrorInfo, State
from xbus.wire.codec import LONGEST_LIVE, ScannedItem, encode_frame, is_sample
from xbus.wire.strings import String, type_at

__all__ = ["Session", "changes_settings"]

#: The state of the device after a message from it. Samples still arrive between GoToConfig and its answer, so
#: they indicate a state only if none is known.
STATE_AFTER: dict[str, State] = {
    "WakeUp": State.WAKEUP,
    "GoToConfigAck": State.CONFIG,
    "GoToMeasurementAck": State.MEASUREMENT,
    "ResetAck": State.UNKNOWN,
}
#: Requests that are valid in any state.
VALID_IN_ANY_STATE = ("GoToConfig", "Reset")
#: The request that finds out the state without changing it: it is valid in Config State only.
PROBE = "ReqDID"
#: Codes of errors about the stream or the device as a whole, which answer no command (Table 5).
UNSOLICITED_ERRORS = frozenset({30, 35, 36, 37, 41, 42, 43, 44, 45, 46, 47, 48, 54, 55})


def changes_settings(command: str) -> bool:
    """Returns whether a command may change what the device sends, or another setting."""
    return command.startswith("Set") or command == "RestoreFactoryDef"


class Session:
    """The connection to a device, for programs that have their own I/O.

    Commands have the names of the manual. One at a time can wait for its answer; samples continue meanwhile.

    Args:
        bid: Bus identifier to address; 0xFF and 1 are the same device.
        strings: Bits of `StringType` for strings that only their length distinguishes from noise.

    Attributes:
        bid: Bus identifier that is addressed.
        state: State of the device.
        support: What the product supports; None until `identify` is called.
        is_in_legacy_mode: Whether the device has acknowledged an empty output configuration: the 10- and
            100-series then send MTData.
        pending: Name of the command that waits for its answer, or None.
        skipped: Bytes that were neither frame nor string.

    >>> from xbus import encode_frame
    >>> session = Session()
    >>> session.request("GoToConfig").hex(" ")
    'fa ff 30 00 d1'
    >>> session.receive(encode_frame(0x31))
    [Reply(command='GoToConfig', value=None, payload=b'')]
    >>> session.state
    <State.CONFIG: 'config'>
    """

    def __init__(self, *, bid: int = 0xFF, strings: int = 0) -> None:
        if not (1 <= bid <= 31 or bid == 0xFF):
            raise ValueError(f"a device has the bus identifier 0xFF or 1 to 31, not {bid}")
        self.bid = bid
        #: Why nothing can be sent, for error messages; None if it can.
        self.refusal: str | None = None
        self.state = State.UNKNOWN
        self.support: Support | None = None
        self.is_in_legacy_mode = False
        self.pending: str | None = None
        self.skipped = 0
        self._scanner = _core.Scanner(LONGEST_LIVE, strings)
        self._clock = _core.SampleClock()
        self._mtdata = _core.MtDataOutputs([])

    # Commands

    def request(self, name: str, value: Any = None) -> bytes:
        """Returns the frame of a command, checked against state and product. The command is then pending.

        Args:
            name: Name of the message, as in `xbus.protocol.tables.MESSAGES`.
            value: The content of the message, as `xbus.protocol.encode` takes it; None if it has none.

        Raises:
            StateError: The state or the product does not accept the command, or another one is pending.
            ValueError: There is no such command, or the value does not fit the message or the product.
        """
        row = MESSAGES.get(name)
        if row is None or row.direction == "to host":
            raise ValueError(f"there is no command {name!r}; xbus messages lists them")
        self.refuse(name)
        if self.pending is not None:
            raise StateError(
                f"{name} must wait: {self.pending} is not answered yet", name, self.state
            )
        self._check_product(name)
        self.check_state(name)
        payload = self.validate(name, value)
        self._mtdata.message(self.bid, row.mid, payload)
        if row.reply is not None:
            self.pending = name
        elif name == "WakeUpAck":
            self.state = State.CONFIG
        return encode_frame(row.mid, payload, bid=self.bid)

    def validate(self, name: str, value: Any = None) -> bytes:
        """Returns the payload of a command, checked against the product, in any state.

        Raises:
            ValueError: The value does not fit the message or the product.
        """
        payload = encode(name, value)
        check(name, value, self.support)
        return payload

    def _check_product(self, name: str) -> None:
        if self.support is None or name in self.support.messages:
            return
        product, row = self.support.product.name, MESSAGES[name]
        if name in self.support.legacy_messages:
            if self.is_in_legacy_mode:
                return
            reason = (
                f"the {product} does not support {name} while it sends MTData2, nothing was sent;"
                " SetOutputConfiguration with an empty list switches to MTData"
            )
        else:
            names = [PRODUCTS[number].name for number in row.products] + list(row.legacy)
            others = ", ".join(names) or "no product"
            reason = (
                f"the {product} does not support {name}, nothing was sent; supported by: {others}"
            )
        raise StateError(reason, name, self.state)

    def check_state(self, name: str) -> None:
        """Checks that a command is valid in the present state.

        Raises:
            StateError: It is not; the message says how to get to a state in which it is.
        """
        self.refuse(name)
        valid = MESSAGES[name].states
        if self.state in valid or name in VALID_IN_ANY_STATE:
            return
        if self.state == State.UNKNOWN and name == PROBE:
            return
        wanted = " or ".join(f"{state.capitalize()} State" for state in valid)
        advice = {
            State.UNKNOWN: "go_to_config() enters a known state",
            State.WAKEUP: "wake_up() enters Config State",
            State.MEASUREMENT: "use it within `with device.configure():`",
            State.CONFIG: "go_to_measurement() enters it",
        }[self.state]
        raise StateError(
            f"{name} is valid in {wanted}, but the state is {self.state}; nothing was sent; {advice}",
            name,
            self.state,
        )

    def refuse(self, name: str) -> None:
        """Checks that anything can be sent.

        Raises:
            StateError: It cannot.
        """
        if self.refusal is not None:
            raise StateError(f"{name} was not sent: {self.refusal}", name, self.state)

    def abandon(self) -> None:
        """Ends the wait for the answer to the pending command. The device may have executed it."""
        if self.pending in ("GoToConfig", "GoToMeasurement", "Reset"):
            self.state = State.UNKNOWN
        self.pending = None

    def forget(self) -> None:
        """Makes the state unknown, for example after the connection was lost."""
        self.state = State.UNKNOWN
        self.pending = None

    def identify(self, support: Support | None) -> None:
        """Sets what the product supports, for the checks of later commands."""
        self.support = support

    # Received bytes

    def receive(self, data: bytes) -> list[SessionEvent]:
        """Returns the events that these bytes complete, in order.

        An incomplete frame waits for the rest of its bytes.
        """
        return self._events(self._scanner.feed(data, last=False))

    def quiet(self) -> list[SessionEvent]:
        """Returns the events among bytes that could be part of an incomplete frame, which counts as damage.

        For a line on which no more of that frame will come, such as after the answer to a command is overdue.
        """
        return self._events(self._scanner.feed(b"", last=True))

    def _events(self, items: list[ScannedItem]) -> list[SessionEvent]:
        return [event for item in items if (event := self.handle(item)) is not None]

    def handle(self, item: ScannedItem) -> SessionEvent | None:
        """Returns the event of a frame or string that a scanner found; None for damage and other devices.

        For programs that scan the stream themselves; `receive` does both.
        """
        if isinstance(item, _core.ScannedDamage):
            self.skipped += item.length
            return None
        if isinstance(item, _core.ScannedString):
            self.handle_data()
            return String(type_at(item.place), item.data, item.offset)
        if not self._is_from_device(item.bid):
            return None
        if is_sample(item):
            self.handle_data()
            sample = Sample(item.payload, item.bid, item.offset)
            sample.time, sample.leads = self._clock.sample(item.bid, item.payload)
            return sample
        if item.mid == MessageId.MTData:
            self.handle_data()
            samples = self._mtdata.samples(item.bid, item.payload)
            if samples is not None and len(samples) == 1:
                output = self._mtdata.output(item.bid)
                sample = Sample(item.payload, item.bid, item.offset, output)
                sample.time, sample.leads = self._clock.sample(item.bid, samples[0].stamps)
                return sample
        self._mtdata.message(item.bid, item.mid, item.payload)
        self._clock.message(item.bid, item.mid, item.payload)
        return self._message(item.offset, item.bid, item.mid, item.payload)

    def handle_data(self) -> None:
        """Handles an output: a device whose state is not known is in Measurement State."""
        if self.state in (State.UNKNOWN, State.WAKEUP):
            self.state = State.MEASUREMENT

    def _is_from_device(self, bid: int) -> bool:
        """Returns whether the addressed device may have sent a frame: its messages have its own BID or FF."""
        return self.bid == 0xFF or bid == 0xFF or _core.device_of(bid) == _core.device_of(self.bid)

    def _message(self, offset: int, bid: int, mid: int, payload: bytes) -> SessionEvent:
        row = MESSAGES.get(self.pending or "")
        if row is not None:
            if mid == row.reply:
                return self._answer(row.name, offset, payload)
            if row.name == "Reset" and mid == MessageId.WakeUp:
                # A device on I²C or SPI may start again before its answer is read.
                self.pending, self.state = None, State.WAKEUP
                return Reply(row.name, None, b"")
            if mid == MessageId.Error and not (payload and payload[0] in UNSOLICITED_ERRORS):
                return self._refused(row.name, offset, payload)
        name = message_name(mid, len(payload))
        self.state = STATE_AFTER.get(name, self.state)
        try:
            value = decode(name, payload) if name in LAYOUTS else payload
        except ValueError:
            value = payload
        return Notice(name, value, payload, bid, mid)

    def _answer(self, command: str, offset: int, payload: bytes) -> Reply | Refusal:
        self.pending = None
        self.state = self._state_after(command)
        try:
            _, value = self.read_reply(command, payload)
        except ValueError as error:
            text = f"cannot decode the reply to {command}: {error}; the device may have executed the command"
            return Refusal(command, DecodeError(text, offset, command=command))
        if command in ("ReqOutputConfiguration", "SetOutputConfiguration"):
            self.is_in_legacy_mode = not value
        elif command == "RestoreFactoryDef":
            self.is_in_legacy_mode = False
        return Reply(command, value, payload)

    def read_reply(self, command: str, payload: bytes) -> tuple[str, Any]:
        """Returns the name and the value of the reply to a command. The value of an empty payload is None.

        Raises:
            ValueError: The payload cannot be decoded.

        >>> Session().read_reply("SetOutputConfiguration", bytes.fromhex("4020 0064"))
        ('SetOutputConfigurationAck', (Output(data_id=16416, frequency=100),))
        """
        problem = ""
        for row in self._reply_rows(command, len(payload)):
            try:
                return row.name, _read(row, payload, command)
            except ValueError as error:
                problem = problem or str(error)
        raise ValueError(problem)

    def _state_after(self, command: str) -> State:
        """Returns the state after an answer: the one that it enters, or else the one in which it is valid."""
        if (state := STATE_AFTER.get(f"{command}Ack")) is not None:
            return state
        return State.CONFIG if MESSAGES[command].states == ("config",) else self.state

    def _reply_rows(self, command: str, length: int) -> list[MessageRow]:
        """Returns the messages that the reply may be, the likeliest first.

        One MID answers a request and a setting, with different payloads, and some products have variants.
        A setting that is acknowledged with a value is acknowledged like the request.
        """
        rows = [row for row in MESSAGES.values() if row.mid == MESSAGES[command].reply]
        if self.support is not None:
            known = self.support.messages | self.support.legacy_messages
            rows = [row for row in rows if row.name in known] or rows
        own = f"{command.removesuffix('Modern')}Ack"
        is_empty = length == 0
        return sorted(rows, key=lambda row: ((row.kind == "empty") != is_empty, row.name != own))

    def _refused(self, command: str, offset: int, payload: bytes) -> Refusal:
        self.pending = None
        if command == PROBE and self.state == State.UNKNOWN:
            self.state = State.MEASUREMENT  # the state in which this request is invalid
        try:
            info: DeviceErrorInfo = decode("Error", payload)
        except ValueError as error:
            text = f"cannot decode the Error that answers {command}: {error}"
            return Refusal(command, DecodeError(text, offset, command=command))
        meaning = RESULT_CODES.get(info.code, "an undocumented code")
        more = f" (and {info.extra.hex(' ')})" if info.extra else ""
        text = f"the device answered {command} with Error {info.code}{more}: {meaning}"
        return Refusal(command, DeviceError(text, info.code, command))


def _read(row: MessageRow, payload: bytes, command: str) -> Any:
    """Returns the value of a reply with the layout of a row.

    Raises:
        ValueError: The reply does not have this layout.
    """
    if row.lengths is not None and len(payload) not in row.lengths:
        raise ValueError(f"{row.name} has {row.payload}, not {len(payload)} bytes")
    if not payload and not LAYOUTS[row.name].several:
        if command.startswith("Req"):
            raise ValueError("the payload is empty")
        return None  # the acknowledgement of a setting
    return decode(row.name, payload)
