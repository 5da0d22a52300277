"""What the host knows of a device: bytes in, events out; commands in, bytes out. No port, clock or thread."""

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
from xbus.wire.codec import LONGEST_LIVE, encode_frame
from xbus.wire.strings import String, type_at

__all__ = ["Session"]

#: What a message of the device says about its state. Samples still come between GoToConfig and its
#: answer, so they prove a state only where none is known.
TRANSITIONS: dict[str, State] = {
    "WakeUp": State.WAKEUP,
    "GoToConfigAck": State.CONFIG,
    "GoToMeasurementAck": State.MEASUREMENT,
    "ResetAck": State.UNKNOWN,
}
#: Requests that may be sent whatever the state is: they make it known, or end it.
ALWAYS = ("GoToConfig", "Reset")
#: The request that tells the states apart without changing them: valid in Config State only.
PROBE = "ReqDID"
#: Errors about the stream or the device as a whole, which come unasked and answer no command (Table 5).
UNASKED = frozenset({30, 35, 36, 37, 41, 42, 43, 44, 45, 46, 47, 48, 54, 55})


class Session:
    """The state of a device, as the host can know it.

    Commands go by the names of the manual. One at a time can wait for its answer; samples keep flowing
    meanwhile.

    Args:
        bid: Bus identifier to address; 0xFF and 1 are the same device.
        strings: Bits of `StringType`, of strings that nothing but their length tells from noise.

    Attributes:
        bid: Bus identifier that is addressed.
        state: State of the device.
        support: What its product supports; None until `identify` was called.
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
        self.state = State.UNKNOWN
        self.support: Support | None = None
        self.pending: str | None = None
        self.skipped = 0
        self._scanner = _core.Scanner(LONGEST_LIVE, strings)

    # Commands

    def request(self, name: str, value: Any = None) -> bytes:
        """The frame of a command, checked against state and product; its answer is then waited for.

        Raises:
            StateError: It cannot be sent in this state, or not to this product.
            ValueError: No such command, or a value that does not fit or that the product cannot do.
        """
        row = MESSAGES.get(name)
        if row is None or row.direction == "to host":
            raise ValueError(f"{name!r} is no command; xbus messages lists them")
        if self.pending is not None:
            raise StateError(
                f"{name} has to wait: {self.pending} is not answered yet", name, self.state
            )
        self._check_product(name)
        self.check_state(name)
        payload = self.validate(name, value)
        if row.reply is not None:
            self.pending = name
        elif name == "WakeUpAck":
            self.state = State.CONFIG
        return encode_frame(row.mid, payload, bid=self.bid)

    def validate(self, name: str, value: Any = None) -> bytes:
        """The payload of a command, checked against the product, whatever the state.

        Raises:
            ValueError: The value does not fit, or is something that the product cannot do.
        """
        payload = encode(name, value)
        check(name, value, self.support)
        return payload

    def _check_product(self, name: str) -> None:
        if self.support is None or name in self.support.messages:
            return
        numbers = MESSAGES[name].products
        others = ", ".join(PRODUCTS[it].name for it in numbers) or "no product of this manual"
        product = self.support.product.name
        raise StateError(
            f"the {product} does not know {name}, nothing was sent; those that do: {others}",
            name,
            self.state,
        )

    def check_state(self, name: str) -> None:
        """Whether a command can be sent now.

        Raises:
            StateError: The device is in another state than those in which the command is valid.
        """
        valid = MESSAGES[name].states
        if self.state in valid or name in ALWAYS:
            return
        if self.state == State.UNKNOWN and name == PROBE:
            return
        wanted = " or ".join(f"{it.capitalize()} State" for it in valid)
        advice = {
            State.UNKNOWN: "go_to_config() makes the state known",
            State.WAKEUP: "wake_up() leads to Config State",
            State.MEASUREMENT: "use it within `with device.configure():`",
            State.CONFIG: "go_to_measurement() leads there",
        }[self.state]
        raise StateError(
            f"{name} is valid in {wanted}, but the state is {self.state}; nothing was sent; {advice}",
            name,
            self.state,
        )

    def abandon(self) -> None:
        """Waits no longer for the answer to the pending command, which may have been obeyed all the same."""
        if self.pending in ("GoToConfig", "GoToMeasurement", "Reset"):
            self.state = State.UNKNOWN
        self.pending = None

    def forget(self) -> None:
        """Forgets the state: the connection was lost, or the device may have done anything meanwhile."""
        self.state = State.UNKNOWN
        self.pending = None

    def identify(self, support: Support | None) -> None:
        """Takes note of what the product supports."""
        self.support = support

    # What comes

    def receive(self, data: bytes) -> list[SessionEvent]:
        """The events that can be told with these bytes, in order."""
        return self._events(self._scanner.feed(data, last=False))

    def quiet(self) -> list[SessionEvent]:
        """The events that can be told because the line has gone quiet; what is incomplete then is damage."""
        return self._events(self._scanner.feed(b"", last=True))

    def _events(
        self, items: list[_core.ScannedFrame | _core.ScannedString | _core.ScannedDamage]
    ) -> list[SessionEvent]:
        events: list[SessionEvent] = []
        for item in items:
            match item:
                case _core.ScannedFrame(offset=offset, bid=bid, mid=mid, payload=payload):
                    if self._is_ours(bid):
                        events.append(self._event(offset, bid, mid, payload))
                case _core.ScannedString():
                    events.append(self._string(item.offset, item.place, item.data))
                case _core.ScannedDamage():
                    self.skipped += item.length
        return events

    def _string(self, offset: int, place: int | None, data: bytes) -> String:
        if self.state in (State.UNKNOWN, State.WAKEUP):
            self.state = State.MEASUREMENT
        return String(type_at(place), data, offset)

    def _is_ours(self, bid: int) -> bool:
        """Whether the addressed device may have sent it: what comes unasked has FF, or its own."""
        return self.bid == 0xFF or bid in (self.bid, 0xFF)

    def _event(self, offset: int, bid: int, mid: int, payload: bytes) -> SessionEvent:
        if mid == MessageId.MTData2:
            if self.state in (State.UNKNOWN, State.WAKEUP):
                self.state = State.MEASUREMENT
            return Sample(payload, bid, offset)
        row = MESSAGES.get(self.pending or "")
        if row is not None:
            if mid == row.reply:
                return self._answer(row.name, offset, payload)
            if mid == MessageId.Error and not (payload and payload[0] in UNASKED):
                return self._refused(row.name, offset, payload)
        name = message_name(mid, len(payload))
        self.state = TRANSITIONS.get(name, self.state)
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
            text = (
                f"the reply to {command} cannot be read: {error}; the command may have been obeyed"
            )
            return Refusal(command, DecodeError(text, offset, command=command))
        return Reply(command, value, payload)

    def read_reply(self, command: str, payload: bytes) -> tuple[str, Any]:
        """The reply to a command: its name, and what it says, None where it carries nothing.

        Raises:
            ValueError: It cannot be read.

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
        """The state that an answer proves: where the answer leads, or else where the command is valid."""
        if (state := TRANSITIONS.get(f"{command}Ack")) is not None:
            return state
        return State.CONFIG if MESSAGES[command].states == ("config",) else self.state

    def _reply_rows(self, command: str, length: int) -> list[MessageRow]:
        """The rows that the reply may have, the likeliest first.

        A MID answers a request and a setting, each in its way, and some products have ways of their own.
        A setting that is answered with more than nothing is answered like the request.
        """
        rows = [it for it in MESSAGES.values() if it.mid == MESSAGES[command].reply]
        if self.support is not None:
            rows = [it for it in rows if it.name in self.support.messages] or rows
        own = f"{command.removesuffix('Modern')}Ack"
        return sorted(rows, key=lambda it: ((it.kind == "empty") != (length == 0), it.name != own))

    def _refused(self, command: str, offset: int, payload: bytes) -> Refusal:
        self.pending = None
        if command == PROBE and self.state == State.UNKNOWN:
            self.state = State.MEASUREMENT  # the state in which this request is invalid
        try:
            info: DeviceErrorInfo = decode("Error", payload)
        except ValueError as error:
            text = f"the device answered {command} with an Error that cannot be read: {error}"
            return Refusal(command, DecodeError(text, offset, command=command))
        meaning = RESULT_CODES.get(info.code, "an undocumented code")
        more = f" (and {info.extra.hex(' ')})" if info.extra else ""
        text = f"the device answered {command} with Error {info.code}{more}: {meaning}"
        return Refusal(command, DeviceError(text, info.code, command))


def _read(row: MessageRow, payload: bytes, command: str) -> Any:
    """What a reply says, if it is laid out like this row."""
    if row.lengths is not None and len(payload) not in row.lengths:
        raise ValueError(f"{row.name} has {row.payload}, not {len(payload)} bytes")
    if not payload and not LAYOUTS[row.name].several:
        if command.startswith("Req"):
            raise ValueError("it carries nothing")
        return None  # a setting that was taken
    return decode(row.name, payload)
