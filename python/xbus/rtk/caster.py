"""Corrections from an NTRIP caster, with pygnssutils."""

from __future__ import annotations

import contextlib
import logging
import re
import threading
import time
from collections.abc import Callable, Iterator
from queue import Empty, Full, Queue
from typing import Any

from xbus.errors import XbusError
from xbus.extras import require
from xbus.rtk.address import Address, check_texts, parse_address
from xbus.rtk.fix import Position

__all__ = ["Caster", "CasterError"]

#: Seconds without data after which a connection counts as lost.
TIMEOUT = 10
#: Seconds without a correction after which a connection counts as lost that sends other data.
NO_CORRECTION_TIMEOUT = 2 * TIMEOUT
#: Seconds until the first new attempt, doubled for each further one, and their maximum.
FIRST_PAUSE, MAX_PAUSE = 1.0, 60.0
#: Seconds between two checks whether there is a position.
POSITION_INTERVAL = 0.1
#: Maximum number of messages that wait to be read.
QUEUE_SIZE = 1000
#: Maximum number of mountpoints in an error message.
MAX_NAMED = 10
#: Metres: receivers work up to 50 km, and sea level is within 110 m of the ellipsoid.
MAX_HEIGHT, MAX_SEPARATION = 99_999.0, 999.0
#: How pygnssutils reports that the connection was closed before a status line, and that no data came.
NO_STATUS, TIMED_OUT = ("KeyError('code')", "ConnectionResetError"), "TimeoutError"


class CasterError(XbusError):
    """A caster cannot be reached, or refuses the request."""


class Caster:
    """Corrections from an NTRIP caster, frame by frame.

    The first read connects. An error before the caster has accepted the request is raised. After that, a lost
    connection is opened again, after a pause that doubles from 1 to 60 s; a connection without data for 10 s
    counts as lost.

    Args:
        url: ``HOST``, ``HOST:PORT``, or with ``http://`` or ``https://`` before it. The port is 2101, and 443
            for https.
        mountpoint: Name of the stream.
        user: User name, if the caster needs one.
        password: Password, if the caster needs one.
        gga: Seconds between two positions (NMEA GGA) that are sent to the caster; None sends none. Network
            services need positions, because they compute corrections for the place of the receiver.
        position: Returns the position to send, or None if it is not known yet; the caster is not contacted
            before it is. Called from another thread.
        ntrip: Version of the protocol. 1 sends the first position directly after the request, which some
            casters wait for.

    Attributes:
        host: Host and port.
        state: ``"idle"``, ``"no position"`` (waits for one), ``"connecting"``, ``"streaming"`` or ``"lost"``.
        problem: Why the last connection ended, or None.
        gga_sent: Positions sent while corrections arrived.

    Raises:
        ValueError: The URL is not an address of a caster, or an argument has a line break.
    """

    def __init__(
        self,
        url: str,
        mountpoint: str,
        *,
        user: str | None = None,
        password: str | None = None,
        gga: int | None = None,
        position: Callable[[], Position | None] = lambda: None,
        ntrip: int = 2,
    ) -> None:
        check_texts(mountpoint=mountpoint, user=user, password=password)
        address = parse_address(url)
        self.host = str(address)
        self.state = "idle"
        self.problem: str | None = None
        self.gga_sent = 0
        self._request = {
            "server": address.host,
            "port": address.port,
            "https": address.https,
            "mountpoint": mountpoint,
            "version": f"{ntrip}.0",
            "ntripuser": user or "",
            "ntrippassword": password or "",
            "ggainterval": -1 if gga is None else gga,
        }
        self._position = position
        self._connection: _Connection | None = None
        self._was_accepted = False
        self._pause = FIRST_PAUSE
        self._retry_at = self._received_at = 0.0
        self._closed = threading.Event()

    def read(self, timeout: float = 0.0) -> bytes:
        """Returns the next frame; empty if none comes in time, or the caster is closed.

        Args:
            timeout: Seconds to wait for it.

        Raises:
            CasterError: The caster could not be reached, or refused, before it ever accepted the request.
            ImportError: The extra ``rtk`` is not installed.
        """
        until = time.monotonic() + timeout
        while not self._closed.is_set():
            frame = self._next(until)
            if frame or time.monotonic() >= until:
                return frame
        return b""

    def __iter__(self) -> Iterator[bytes]:
        """Yields frames until the caster is closed, which another thread may do."""
        while not self._closed.is_set():
            if frame := self.read(TIMEOUT):
                yield frame

    def close(self) -> None:
        """Closes the connection. The caster cannot be used again."""
        self._closed.set()
        self.state = "idle"
        if (connection := self._connection) is not None:
            connection.close()

    def __enter__(self) -> Caster:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _next(self, until: float) -> bytes:
        connection = self._connection or self._connect(until)
        if connection is None:
            return b""
        try:
            raw, reason = connection.queue.get(timeout=max(until - time.monotonic(), 0))
        except Empty:
            if time.monotonic() - self._received_at > NO_CORRECTION_TIMEOUT:
                self._ended(connection, TIMED_OUT)
            return b""
        if isinstance(raw, list):
            connection.mountpoints = [row[0] for row in raw]
        elif not raw:
            self._ended(connection, reason)
        elif raw.startswith(b"$"):
            self.gga_sent += 1
        else:
            self.state, self.problem = "streaming", None
            self._pause = FIRST_PAUSE
            self._was_accepted = True
            self._received_at = time.monotonic()
            connection.has_streamed = True
            return bytes(raw)
        return b""

    def _connect(self, until: float) -> _Connection | None:
        """Opens a connection if the next attempt is due; otherwise waits for it, up to ``until``."""
        wait = self._retry_at - time.monotonic()
        if wait <= 0 and self._request["ggainterval"] != -1 and self._position() is None:
            self.state, wait = "no position", POSITION_INTERVAL
        if wait > 0:
            self._closed.wait(max(min(wait, until - time.monotonic()), 0))
            return None
        self.state = "connecting"
        self._received_at = time.monotonic()
        connection = self._connection = _Connection(self._request, self._position)
        if self._closed.is_set():  # meanwhile, when `close` did not see this connection yet
            connection.close()
        return connection

    def _ended(self, connection: _Connection, reason: str | None) -> None:
        if self._closed.is_set():
            return
        self._connection = None
        connection.close()
        self.problem = self._why(connection, reason)
        if not (self._was_accepted or connection.is_accepted):
            self.state = "idle"
            raise CasterError(self.problem)
        self._was_accepted = True
        self.state = "lost"
        self._retry_at = time.monotonic() + self._pause
        self._pause = min(2 * self._pause, MAX_PAUSE)

    def _why(self, connection: _Connection, reason: str | None) -> str:
        """Returns why a connection has ended, in one sentence."""
        code, mountpoint, reason = connection.code, self._request["mountpoint"], reason or ""
        if code is None and reason.startswith(NO_STATUS):
            return no_answer(self.host)
        if code == 401:
            return no_access(self.host)
        names = connection.mountpoints
        if mountpoint in names:
            return (
                f"{self.host} lists {mountpoint}, but answers with its source table instead of"
                " corrections; the base station may be off, or the account may not include it"
            )
        if connection.is_sourcetable or code == 404:
            some = ", ".join(names[:MAX_NAMED]) + (", ..." if len(names) > MAX_NAMED else "")
            more = f"; it has {some}" if some else "; xbus ntrip --list prints those that it has"
            return f"{self.host} has no mountpoint {mountpoint}{more}"
        if code is not None and code != 200:
            return (
                f"{self.host} refused: {(reason or str(code)).removeprefix('Connection failed ')}"
            )
        if code == 200 and reason.startswith(TIMED_OUT):
            return f"{self.host} is connected, but sends no corrections"
        if code == 200:
            before = "" if connection.has_streamed else " before the first correction"
            return f"{self.host} has hung up{before}"
        text = reason or "the connection was closed"
        if text.startswith(("IndexError", "ValueError", "UnicodeDecodeError")):
            return no_caster(self.host)
        # The reason is the repr of an exception: ConnectionRefusedError(111, 'Connection refused').
        words = re.search(r"""['"](.+)['"]""", text)
        return f"cannot reach {self.host}: {words[1] if words else text}"


def no_answer(host: Address | str) -> str:
    """Returns that a caster closes the connection before it answers."""
    return (
        f"{host} hangs up without an answer; check the port, and whether the address needs https://"
    )


def no_access(host: Address | str) -> str:
    """Returns that a caster refuses the user."""
    return f"{host} does not let that user in (401); check user and password"


def no_caster(host: Address | str) -> str:
    """Returns that something else answers."""
    return f"the server at {host} is not an NTRIP caster"


class _Connection:
    """One connection. Runs a thread of pygnssutils, and is the application for it."""

    def __init__(self, request: dict[str, Any], position: Callable[[], Position | None]) -> None:
        pygnssutils = require("pygnssutils", "rtk", "to get corrections from a caster")
        #: A frame or GGA with its parsed form; or empty, with the reason for the end or None.
        self.queue: Queue[tuple[Any, Any]] = Queue(QUEUE_SIZE)
        self.mountpoints: list[str] = []
        self.has_streamed = False
        self._position = position
        self._stop = threading.Event()
        # pygnssutils lets loggers print. Only the application should decide that.
        logging.getLogger("pygnssutils").addHandler(_NOWHERE)
        loggers = [logging.getLogger(name) for name in ("pyrtcm", "pyspartn")]
        before = [list(logger.handlers) for logger in loggers]
        # One attempt: `Caster` decides when to try again.
        self._client = _client_class(pygnssutils)(app=self, retries=0, timeout=TIMEOUT)
        for logger, handlers in zip(loggers, before, strict=True):
            logger.handlers[:] = handlers
        self._client.run(**request, output=self.queue, stopevent=self._stop)

    @property
    def code(self) -> int | None:
        """The status code of the caster's answer; None without an answer."""
        found: int | None = self._client.status.get("code")
        return found

    @property
    def is_sourcetable(self) -> bool:
        """Whether the caster answered with its source table, as it does for an unknown mountpoint."""
        return self.code is not None and bool(self._client.is_sourcetable)

    @property
    def is_accepted(self) -> bool:
        """Whether the caster has accepted the request."""
        return self.code == 200 and not self.is_sourcetable

    def close(self) -> None:
        """Closes the connection. The thread ends when it wakes up, within ``TIMEOUT``."""
        self._client.stop()
        # The thread may wait for space in the queue or, after the caster has closed, fill it with empty
        # items.
        with contextlib.suppress(Empty):
            while True:
                self.queue.get_nowait()
        # A reader may wait for an item.
        with contextlib.suppress(Full):
            self.queue.put_nowait((b"", None))

    # The interface that pygnssutils requires of an application

    def dialog(self, _: str) -> _Connection:
        """Returns the object that receives status messages."""
        return self

    def set_controls(self, connected: bool, message: tuple[str, str]) -> None:
        """Receives a status message."""
        if not connected:
            self.queue.put((b"", message[0]))

    def get_coordinates(self) -> dict[str, Any]:
        """Returns the position to send."""
        at = self._position()
        if at is None:
            raise ValueError("no position")  # pygnssutils then sends none
        # An empty text leaves a field of the sentence empty: what was not measured is not sent. Rounded, and
        # without the impossible heights of a damaged sample, no sentence is longer than the 82 characters
        # that NMEA 0183 allows.
        return {
            "lat": at.lat,
            "lon": at.lon,
            "alt": round(max(-MAX_HEIGHT, min(at.alt, MAX_HEIGHT)), 2),
            "sep": round(max(-MAX_SEPARATION, min(at.sep, MAX_SEPARATION)), 1),
            "fix": "3D",
            "sip": "" if at.satellites is None else min(at.satellites, 99),
            "hdop": "" if at.hdop is None else min(round(at.hdop, 2), 99.99),
            "diffage": "",
            "diffstation": "",
        }


_NOWHERE = logging.NullHandler()


def _client_class(pygnssutils: Any) -> Any:
    class Client(pygnssutils.GNSSNTRIPClient):  # type: ignore[misc]
        def _do_request(self, *args: Any) -> int:
            if super()._do_request(*args) and not self.stopevent.is_set():
                # The caster has closed the connection. The client would wait, and connect again without
                # notice.
                raise ConnectionResetError
            return 0

        def _close_connection(self, sock: Any) -> None:
            super()._close_connection(sock)
            # The client leaves a socket open after the caster has closed it, because its shutdown fails.
            if sock is not None:
                sock.close()

    return Client
