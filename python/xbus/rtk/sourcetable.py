"""The source table of an NTRIP caster: the mountpoints that it offers."""

from __future__ import annotations

import base64
import contextlib
import math
import socket
import ssl
import time
from typing import NamedTuple

from xbus._core import __version__
from xbus.rtk.address import Address, check_texts, parse_address
from xbus.rtk.caster import TIMEOUT, CasterError, no_access, no_answer, no_caster

__all__ = ["Mountpoint", "read_source_table"]

#: The last line of a table. Some casters keep the connection open after it.
END = b"ENDSOURCETABLE"
#: Bytes of a source table at most; that of the largest caster has 0.2 MB.
MAX_TABLE = 1 << 24


class Mountpoint(NamedTuple):
    """One stream of a caster.

    Attributes:
        name: The name to ask for.
        place: Where the base station is, in words.
        format: Format of the corrections, such as ``RTCM 3.2``.
        details: Their message types, with the period in seconds in parentheses.
        systems: Satellite systems, such as ``GPS+GLO``.
        country: Code of the country.
        lat: Latitude in degrees, or None.
        lon: Longitude in degrees, or None.
        needs_position: Whether the caster expects positions (``--gga``).
    """

    name: str
    place: str
    format: str
    details: str
    systems: str
    country: str
    lat: float | None
    lon: float | None
    needs_position: bool


def read_source_table(
    url: str, *, user: str | None = None, password: str | None = None
) -> list[Mountpoint]:
    """Returns the mountpoints of a caster.

    Args:
        url: Address of the caster, as for `Caster`.
        user: User name, if the caster needs one.
        password: Password, if the caster needs one.

    Raises:
        CasterError: The caster cannot be reached, refuses, or has no source table.
        ValueError: An argument is not valid.
    """
    address = parse_address(url)
    check_texts(user=user, password=password)
    # Version 1.0 of HTTP: the answer is not split into chunks, and casters of NTRIP 1 accept it too.
    lines = [
        "GET / HTTP/1.0",
        f"Host: {address}",
        f"User-Agent: NTRIP xbus/{__version__}",
        "Accept: */*",
        "Connection: close",
    ]
    if user:
        credentials = base64.b64encode(f"{user}:{password or ''}".encode()).decode()
        lines.append(f"Authorization: Basic {credentials}")
    answer = _ask(address, "\r\n".join([*lines, "", ""]).encode())
    if not answer:
        raise CasterError(no_answer(address))
    protocol, _, rest = answer.partition(b"\r\n")[0].decode(errors="replace").partition(" ")
    code = rest[:3]
    if not (protocol.startswith("HTTP/") or protocol == "SOURCETABLE") or not code.isdecimal():
        raise CasterError(no_caster(address))
    if code == "401":
        raise CasterError(no_access(address))
    if code != "200":
        raise CasterError(f"{address} refused: {rest}")
    rows = [line.decode(errors="replace").split(";") for line in answer.splitlines()]
    if not any(row[0] in ("STR", END.decode()) for row in rows):
        raise CasterError(no_caster(address))
    return [_mountpoint(row) for row in rows if row[0] == "STR" and len(row) > 1]


def _ask(address: Address, request: bytes) -> bytes:
    """Returns what the caster answers, up to the end of its table."""
    until = time.monotonic() + TIMEOUT
    answer = bytearray()
    try:
        with contextlib.ExitStack() as stack:
            connection = stack.enter_context(
                socket.create_connection((address.host, address.port), timeout=TIMEOUT)
            )
            if address.https:
                context = ssl.create_default_context()
                connection = stack.enter_context(
                    context.wrap_socket(connection, server_hostname=address.host)
                )
            connection.sendall(request)
            while END not in answer[-4096:] and len(answer) < MAX_TABLE:
                connection.settimeout(max(until - time.monotonic(), 0.001))
                try:
                    piece = connection.recv(2048)
                except ConnectionResetError:
                    break
                if not piece:
                    break
                answer += piece
    except OSError as error:
        raise CasterError(f"cannot reach {address}: {error.strerror or error}") from error
    return bytes(answer)


def _mountpoint(row: list[str]) -> Mountpoint:
    """Returns the mountpoint of a line: columns that are missing are empty."""
    cells = [*row, *[""] * 12]
    return Mountpoint(
        name=cells[1],
        place=cells[2],
        format=cells[3],
        details=cells[4],
        systems=cells[6],
        country=cells[8],
        lat=_number(cells[9]),
        lon=_number(cells[10]),
        needs_position=cells[11] == "1",
    )


def _number(text: str) -> float | None:
    try:
        number = float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None
