"""What can go wrong.

XbusError
├─ DecodeError(ValueError)        bytes that do not add up: in a log (strict), or a reply of the wrong length
├─ StateError(RuntimeError)       asked too early or of the wrong product; nothing was sent
├─ DeviceError                    the device answered Error (0x42)
├─ XbusTimeout(TimeoutError)      nothing came
├─ ApplyError                     settings were applied in part
└─ Disconnected(ConnectionError)  the port is gone
"""

from __future__ import annotations

__all__ = [
    "DecodeError",
    "DeviceError",
    "Disconnected",
    "StateError",
    "XbusError",
    "XbusTimeout",
]


class XbusError(Exception):
    """Base of everything that xbus raises on its own account."""


class DecodeError(XbusError, ValueError):
    """Bytes that do not add up: in a log that is read with ``strict=True``, or in a reply.

    Attributes:
        offset: Where the damage or the frame at fault begins, in bytes from the start of the input.
        data_id: Data identifier of the packet at fault, or None where the frame itself is.
        command: Name of the command whose reply it is, or None in a log.
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
    """A command that the device cannot take now; nothing was sent.

    Attributes:
        command: Name of the command.
        state: State of the device.
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
        command: Name of the command it answers, or None for an Error that came unasked.
    """

    def __init__(self, message: str, code: int, command: str | None = None) -> None:
        super().__init__(message, code, command)
        self.code = code
        self.command = command

    def __str__(self) -> str:
        return str(self.args[0])


class XbusTimeout(XbusError, TimeoutError):  # noqa: N818 - the name says more than an ending would
    """Nothing came.

    Attributes:
        command: Name of the command that was not answered, or None when listening.
        waited: Seconds.
    """

    def __init__(self, message: str, command: str | None, waited: float) -> None:
        super().__init__(message, command, waited)
        self.command = command
        self.waited = waited

    def __str__(self) -> str:
        return str(self.args[0])


class Disconnected(XbusError, ConnectionError):  # noqa: N818 - the name says more than an ending would
    """The port is gone: unplugged, or closed on the other side.

    Attributes:
        command: Name of the command that was under way, or None when listening.
    """

    def __init__(self, message: str, command: str | None = None) -> None:
        super().__init__(message, command)
        self.command = command

    def __str__(self) -> str:
        return str(self.args[0])
