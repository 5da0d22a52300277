"""Why nothing was heard on a port, in words."""

from __future__ import annotations

from collections.abc import Mapping

from xbus.formatting import format_count

__all__ = ["nothing_heard"]


def nothing_heard(
    port: str, received: Mapping[int | None, int], *, is_line: bool, is_listening: bool
) -> str:
    """Returns the message about a port on which no message was heard, with the remedies.

    Args:
        port: Name of the port.
        received: Number of bytes received at each baud rate that was tried; None for a port without one.
        is_line: Whether the port has a baud rate.
        is_listening: Whether nothing was sent.

    >>> nothing_heard("/dev/ttyUSB0", {9600: 1234}, is_line=True, is_listening=False)
    '1,234 bytes arrived on /dev/ttyUSB0 at 9600 baud, but no message; 9600 baud is probably not the rate of \
the device: leave the baud rate out (no --baudrate), and xbus finds it'
    """
    if None in received:
        return (
            f"nothing was heard on {port}, but the device on the bus answers; switch it off and on, or reset"
            " it with its pin nRST"
        )
    rates = ", ".join(map(str, received)) + " baud"
    where = f"{port} at {rates}" if is_line else port
    one_rate = is_line and len(received) == 1
    if any(received.values()):
        counts = [f"{format_count(n, 'byte')} at {rate}" for rate, n in received.items() if n]
        if one_rate:
            (count,) = received.values()
            return (
                f"{format_count(count, 'byte')} arrived on {where}, but no message; {rates} is probably"
                " not the rate of the device: leave the baud rate out (no --baudrate), and xbus finds it"
            )
        if not is_line:
            total = format_count(sum(received.values()), "byte")
            return f"{total} arrived on {port}, but no message; what sends there is not an MTi"
        return (
            f"bytes arrived on {port}, but no message ({', '.join(counts)} baud); the device probably uses"
            f" another baud rate than {rates}, or is not an MTi" + _restore(port, is_listening)
        )
    if is_listening:
        advice = "with a baud rate (--baudrate) xbus waits for a device that is silent now"
        return f"nothing was heard on {where}; {advice}"
    check = "check that the device is powered and connected, and that no other program, such as ModemManager,"
    find = (
        "; without a baud rate (no --baudrate) xbus tries all that devices use" if one_rate else ""
    )
    return (
        f"nothing was heard on {where}; {check} uses the port{find or _restore(port, is_listening)}"
    )


def _restore(port: str, is_listening: bool) -> str:
    if is_listening:
        return ""
    return f"; xbus restore {port} recovers a device that answers at no baud rate"
