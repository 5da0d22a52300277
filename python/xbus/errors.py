"""The exceptions of xbus.

XbusError
├─ DecodeError(ValueError)        invalid bytes: in a log (strict), in a string or in a reply
├─ StateError(RuntimeError)       the command does not fit the state or the product; nothing was sent
├─ DeviceError                    the device answered Error (0x42)
├─ XbusTimeout(TimeoutError)      no answer
├─ ApplyError                     some settings were applied before one failed
└─ Disconnected(ConnectionError)  the port is gone

BusError(OSError)                  I²C, SPI or CAN cannot be opened; later, the port is gone
"""

from __future__ import annotations

__all__ = [
    "BusError",
    "DecodeError",
    "DeviceError",
    "Disconnected",
    "StateError",
    "XbusError",
    "XbusTimeout",
]


class XbusError(Exception):
    """Base class of the exceptions of xbus.

    >>> import xbus
    >>> try:
    ...     xbus.connect("sim:MTi-630?fault=unplug=0")
    ... except xbus.XbusError as error:
    ...     print(type(error).__name__)
    Disconnected
    """


class DecodeError(XbusError, ValueError):
    """Invalid bytes: in a log that is read with ``strict=True``, in a string, or in a reply.

    Attributes:
        offset: Byte offset in the input at which the damage or the invalid frame begins.
        data_id: Data identifier of the invalid packet, or None if the frame itself is invalid.
        command: Name of the command whose reply is invalid, or None in a log.

    >>> import xbus
    >>> try:
    ...     xbus.read_log("tests/captures/field.mtb", strict=True)
    ... except xbus.DecodeError as error:
    ...     print(error.offset, error)
    0 no frame at byte 0 (no preamble); read without strict to skip the damage
    """

    def __init__(
        self, message: str, offset: int, data_id: int | None = None, command: str | None = None
    ) -> None:
        super().__init__(message, offset, data_id, command)
        self.offset = offset
        self.data_id = data_id
        self.command = command

    def __str__(self) -> str:
        return str(self.args[0])


class StateError(XbusError, RuntimeError):
    """A command that does not fit the state of the device, or the product. Nothing was sent.

    Attributes:
        command: Name of the command.
        state: State of the device.

    >>> import xbus
    >>> device = xbus.connect("sim:MTi-630")
    >>> try:
    ...     device.commands.set_location_id(7)
    ... except xbus.StateError as error:
    ...     print(error.command, error.state)
    SetLocationID measurement
    """

    def __init__(self, message: str, command: str, state: str) -> None:
        super().__init__(message, command, state)
        self.command = command
        self.state = state

    def __str__(self) -> str:
        return str(self.args[0])


class DeviceError(XbusError):
    """The device answered with an Error message (0x42).

    Attributes:
        code: The error code, Table 5 of the manual.
        command: Name of the command that it answers, or None for an Error without a command.

    >>> import xbus
    >>> device = xbus.connect("sim:MTi-630")
    >>> device.go_to_config()
    >>> try:
    ...     device.command("ResetOrientation", 1)
    ... except xbus.DeviceError as error:
    ...     print(error.command, error.code)
    ResetOrientation 4
    """

    def __init__(self, message: str, code: int, command: str | None = None) -> None:
        super().__init__(message, code, command)
        self.code = code
        self.command = command

    def __str__(self) -> str:
        return str(self.args[0])


class XbusTimeout(XbusError, TimeoutError):  # noqa: N818 - the name is clear without a suffix
    """No answer arrived in time.

    Attributes:
        command: Name of the command without an answer, or None while listening.
        waited: Seconds until the timeout.

    >>> import xbus
    >>> try:
    ...     xbus.connect("sim:MTi-630?fault=stall=0:60")  # sends nothing for a minute
    ... except xbus.XbusTimeout as error:
    ...     print(error.waited > 1)
    True
    """

    def __init__(self, message: str, command: str | None, waited: float) -> None:
        super().__init__(message, command, waited)
        self.command = command
        self.waited = waited

    def __str__(self) -> str:
        return str(self.args[0])


class Disconnected(XbusError, ConnectionError):  # noqa: N818 - the name is clear without a suffix
    """The port is gone: unplugged, or closed on the other side.

    Attributes:
        command: Name of the interrupted command, or None while listening.

    >>> import xbus
    >>> mti = xbus.SimulatedDevice("MTi-300")
    >>> device = xbus.connect(mti)
    >>> mti.unplug()
    >>> try:
    ...     device.go_to_config()
    ... except xbus.Disconnected as error:
    ...     print(error.command)
    GoToConfig
    """

    def __init__(self, message: str, command: str | None = None) -> None:
        super().__init__(message, command)
        self.command = command

    def __str__(self) -> str:
        return str(self.args[0])


class BusError(OSError):
    """I²C, SPI or CAN cannot be opened, a transfer failed, or it returned what no MTi sends.

    The message says what to try. `Disconnected` replaces this exception once a device is connected.
    """

    def __str__(self) -> str:
        return str(self.args[-1])
