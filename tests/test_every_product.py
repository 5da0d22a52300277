"""Every message and every setting on every product: session and virtual device follow the tables."""

from __future__ import annotations

from itertools import product as product_of
from typing import Any

import pytest

from xbus import (
    MessageId,
    Session,
    SimulatedDevice,
    StateError,
    encode_frame,
)
from xbus.device.checks import check
from xbus.device.events import Refusal, Reply
from xbus.protocol import (
    EVERY,
    AlignmentRotation,
    CanConfig,
    GnssLeverArm,
    GnssReceiverSettings,
    IccCommand,
    LatLonAlt,
    OptionFlag,
    OptionFlags,
    Output,
    PortConfig,
    ResetCode,
    State,
    StringOutput,
    StringType,
    SyncSetting,
    UtcTime,
    baudrate,
    encode,
)
from xbus.protocol.ids import DataId
from xbus.protocol.products import BASE, HEADING, Support, support
from xbus.protocol.tables import MESSAGES, PRODUCTS, QUANTITIES, MessageRow

STATES = (State.WAKEUP, State.CONFIG, State.MEASUREMENT)
COMMANDS = [row for row in MESSAGES.values() if row.direction != "to host"]
#: Codes of Error messages (Table 5).
MESSAGE, BAUDRATE, PARAMETER = 4, 32, 33


def value_for(row: MessageRow, state: State, known: Support) -> Any:
    """Returns a value that is valid in this state, and for this product if it knows the message."""
    labels = [profile.label for profile in known.filter_profiles]
    numbers = [profile.type for profile in known.filter_profiles]
    is_modern = known.product.series == "600-series"
    values = {
        "SetPeriod": 1152, "SetBaudrate": 0x02, "SetNoRotation": 6, "SetSyncSettings": (),
        "SetOptionFlags": OptionFlags(), "SetUTCTime": UtcTime(0, 2026, 11, 22, 9, 30, 0),
        "SetFilterProfile": numbers[0] if numbers else 1,
        "SetFilterProfileModern": labels[0] if labels else "General",
        "SetGnssLeverArm": GnssLeverArm(0, 0, 1), "SetLatLonAlt": LatLonAlt(52, 6, 0),
        "IccCommand": IccCommand.STORE if state is State.CONFIG else IccCommand.STATE,
        "SetGnssPlatform": 0, "SetLocationID": 1, "SetExtOutputMode": 0,
        "SetPortConfig": (PortConfig(1, 2), PortConfig(0, 0), PortConfig(0, 0)),
        "SetStringOutputType": StringOutput(StringType(0), 0 if is_modern else None),
        "ReqEmts": b"\x00\xff",
        "ResetOrientation": ResetCode.STORE if state is State.CONFIG else ResetCode.INCLINATION,
        "AdjustUTCTime": 0, "SetGnssReceiverSettings": GnssReceiverSettings(3, 2, 4),
        # Without outputs, the 10- and 100-series are in legacy mode.
        "SetOutputConfiguration": (Output(DataId.PacketCounter),),
        "SetOutputSkipFactor": 0, "SetInitialHeading": 0,
        "SetErrorMode": 1, "SetTransmitDelay": 590, "SetCanConfig": CanConfig(0x0C),
        "SetCanOutputConfig": (), "ReqAlignmentRotation": 0,
        "SetAlignmentRotation": AlignmentRotation(0, (1, 0, 0, 0)), "ForwardGnssData": b"\xd3",
        # No product knows these.
        "SetProcessingFlags": 0, "SetGravityMagnitude": 9.8, "SetHeading": 0, "SetAmd": 0,
        "SetOutputMode": 2, "SetOutputSettings": 0,
    }  # fmt: skip
    if row.name in values:
        return values[row.name]
    return None if row.kind == "empty" else bytes(min(row.lengths or (0,)))


def device_in(state: State, product: int) -> SimulatedDevice:
    device = SimulatedDevice(product)
    device.advance(0.1)
    if state is not State.WAKEUP:
        device.write(encode_frame(MessageId.WakeUpAck))
    if state is State.MEASUREMENT:
        device.write(encode_frame(MessageId.GoToMeasurement))
    device.read()
    assert device.state is state
    return device


def session_in(state: State, product: int) -> Session:
    session = Session()
    session.state = state
    session.identify(support(product))
    return session


def exchange(device: SimulatedDevice, wire: bytes) -> bytes:
    device.write(wire)
    return device.read()


def with_message(name: str) -> list[int]:
    """Returns the numbers of the products that know a message."""
    return [product for product in PRODUCTS if product in MESSAGES[name].products]


def frame(name: str, value: Any = None) -> bytes:
    return encode_frame(MESSAGES[name].mid, encode(name, value))


def error(code: int) -> bytes:
    return encode_frame(MessageId.Error, bytes([code]))


# Messages


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("product", PRODUCTS)
def test_every_message(product: int, state: State) -> None:
    """A message is sent and answered if its row has product and state; else StateError, and Error 4."""
    device = device_in(state, product)
    for row in COMMANDS:
        if device.state is not state:
            device = device_in(state, product)
        session, value = session_in(state, product), value_for(row, state, support(product))
        wire = frame(row.name, value)
        answer = exchange(device, wire)
        is_known = product in row.products
        is_taken = is_known and state in row.states
        # A host that missed WakeUp sends GoToConfig.
        is_answered = is_taken or (is_known and row.name == "GoToConfig")
        if row.name == "WakeUpAck" or (is_answered and row.reply is None):
            assert answer == b"", row.name
        elif is_answered:
            assert answer[:3] == bytes([0xFA, 0xFF, row.reply or 0]), row.name
        else:
            assert answer == error(PARAMETER if has_twin(row, product, state) else MESSAGE)

        if is_answered or (is_known and row.name == "Reset"):
            assert session.request(row.name, value) == wire
        else:
            name = support(product).product.name
            reason = "is valid in" if is_known else f"the {name} does not support {row.name}"
            with pytest.raises(StateError, match=reason) as caught:
                session.request(row.name, value)
            assert (caught.value.command, session.pending) == (row.name, None)
            continue
        if answer:
            (event,) = session.receive(answer) + session.quiet()
            assert isinstance(event, Reply if is_answered else Refusal), row.name
        if row.name == "Reset":
            device = device_in(state, product)
        else:
            assert session.state is device.state, row.name


def has_twin(row: MessageRow, product: int, state: State) -> bool:
    """Whether the product has another message of this MID, with other lengths."""
    return any(
        other.mid == row.mid and product in other.products and state in other.states
        for other in COMMANDS
    )


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("product", PRODUCTS)
def test_messages_that_are_not_commands_are_refused(product: int, state: State) -> None:
    device, session = device_in(state, product), session_in(state, product)
    for mid in set(range(256)) - {other.mid for other in COMMANDS}:
        assert exchange(device, encode_frame(mid)) == error(MESSAGE), mid
    for row in MESSAGES.values():
        if row.direction == "to host":
            with pytest.raises(ValueError, match="there is no command"):
                session.request(row.name)
    assert device.state is state


# Settings


def both(product: int) -> tuple[SimulatedDevice, Support]:
    return device_in(State.CONFIG, product), support(product)


def is_sent(known: Support, name: str, value: Any) -> bool:
    """Whether the host accepts a value for this product."""
    try:
        check(name, value, known)
    except ValueError:
        return False
    return True


def is_taken(
    device: SimulatedDevice, known: Support, name: str, value: Any, code: int = PARAMETER
) -> bool:
    """Whether host and device accept a value. Both must agree, and a refusal changes nothing."""
    before = device.settings
    answer = exchange(device, frame(name, value))
    # The setting can change the bus identifier.
    is_refused = answer[2:-1] == error(code)[2:-1]
    if is_refused:
        assert device.settings is before
    else:
        assert answer[2] == MESSAGES[name].reply
    assert is_sent(known, name, value) != is_refused, (name, value)
    return not is_refused


#: The rates that any product has, and those beside them: only there may an answer change.
STEPS = {
    rate
    for known in map(support, PRODUCTS)
    for name in known.rates
    for rate in (0, *known.rates_of(name), EVERY)
}
RATES = sorted({rate + step for rate in STEPS for step in (-1, 0, 1)} & set(range(EVERY + 1)))


@pytest.mark.parametrize("product", PRODUCTS)
def test_every_rate_of_every_quantity(product: int) -> None:
    """The host accepts the rates of the table; the device acknowledges any rate as the table says."""
    device, known = both(product)
    rates_of = {name: known.rates_of(name) for name in known.rates}
    for rate in RATES:
        outputs = [Output(QUANTITIES[name].id, rate) for name in rates_of]
        expected = tuple(known.acknowledged(output) for output in outputs)
        answer = exchange(device, frame("SetOutputConfiguration", outputs))
        assert answer == frame("SetOutputConfigurationAck", expected), rate
        assert device.settings.output_configuration == expected
        for rates, output in zip(rates_of.values(), outputs, strict=True):
            is_there = rate in (0, EVERY, *rates) or rates == (EVERY,)
            assert is_sent(known, "SetOutputConfiguration", [output]) == is_there, output


@pytest.mark.parametrize("product", PRODUCTS)
def test_every_identifier(product: int) -> None:
    """An identifier that the product lacks makes the device refuse the whole message."""
    device, known = both(product)
    quantities = {quantity.id: quantity for quantity in QUANTITIES.values()}
    for data_id in range(0, 0x10000, 0x10):
        outputs = [Output(DataId.PacketCounter), Output(data_id, 1)]
        is_there = data_id in quantities and quantities[data_id].name in known.rates
        if data_id in quantities and rates_are_fixed(known, quantities[data_id].name):
            outputs[1] = Output(data_id)
        taken = is_taken(device, known, "SetOutputConfiguration", outputs)
        assert taken == is_there, f"{data_id:04X}"


def rates_are_fixed(known: Support, quantity: str) -> bool:
    return len(known.rates_of(quantity)) == 1


@pytest.mark.parametrize("product", PRODUCTS)
def test_every_sync_function_on_every_line(product: int) -> None:
    device, known = both(product)
    for function, line in product_of(range(20), range(16)):
        is_there = any(
            function == supported and line in known.sync[supported] for supported in known.sync
        )
        settings = (SyncSetting(function, line),)
        assert is_taken(device, known, "SetSyncSettings", settings) == is_there, (function, line)


@pytest.mark.parametrize("product", PRODUCTS)
def test_every_option_flag(product: int) -> None:
    """Bits without a name included. Clearing a flag that the product lacks is accepted."""
    device, known = both(product)
    for bit in range(32):
        flag = OptionFlag(1 << bit)
        assert is_taken(device, known, "SetOptionFlags", OptionFlags(clear=flag))
        is_there = flag in known.option_flags
        assert is_taken(device, known, "SetOptionFlags", OptionFlags(set=flag)) == is_there, flag


@pytest.mark.parametrize("product", with_message("SetStringOutputType"))
def test_every_string(product: int) -> None:
    device, known = both(product)
    is_600 = known.product.series == "600-series"
    rates = (0, 1, 10, 400, 401, 0xFFFF) if is_600 else (None,)
    for bit, rate in product_of(range(16), rates):
        strings = StringOutput(StringType(1 << bit), rate)
        is_there = bool(known.string_types & (1 << bit)) and rate in (None, 1, 10, 400)
        assert is_taken(device, known, "SetStringOutputType", strings) == is_there, strings


@pytest.mark.parametrize("product", with_message("SetFilterProfile"))
def test_every_filter_profile(product: int) -> None:
    device, known = both(product)
    numbers = {profile.type for profile in known.filter_profiles}
    for number in range(300):
        assert is_taken(device, known, "SetFilterProfile", number) == (number in numbers), number


#: The labels of all products.
LABELS = {profile.label for number in PRODUCTS for profile in support(number).filter_profiles}


@pytest.mark.parametrize("product", with_message("SetFilterProfileModern"))
def test_every_label_of_a_filter_profile(product: int) -> None:
    device, known = both(product)
    labels = {profile.label for profile in known.filter_profiles}
    for label in LABELS:
        assert is_taken(device, known, "SetFilterProfileModern", label) == (label in labels), label


@pytest.mark.parametrize("product", with_message("SetFilterProfileModern"))
def test_every_pair_of_labels(product: int) -> None:
    """A profile goes with a heading behaviour, and never with another of its kind."""
    device, known = both(product)
    kinds = {profile.label: profile.type for profile in known.filter_profiles}
    for pair in product_of(LABELS, LABELS):
        is_there = sorted(kinds.get(label, 0) for label in pair) == [BASE, HEADING]
        assert is_taken(device, known, "SetFilterProfileModern", "/".join(pair)) == is_there, pair


@pytest.mark.parametrize("product", PRODUCTS)
def test_every_baud_rate(product: int) -> None:
    device, known = both(product)
    for code in range(256):
        is_there = baudrate(code) in known.baudrates
        assert is_taken(device, known, "SetBaudrate", code, BAUDRATE) == is_there, code
