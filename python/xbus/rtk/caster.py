"""Corrections from an NTRIP caster, by pygnssutils."""

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
    """A caster cannot be reached, or refuses what is wanted of it."""


class Caster:
    """Corrections from an NTRIP caster, frame by frame.

    It connects when it is first read. What goes wrong before the caster has accepted the request is raised.
    Later a lost connection is made again, after a pause that doubles from 1 to 60 s; so is one that brings
    nothing for 10 s.

    Args:
        url: ``HOST``, ``HOST:PORT``, or with ``http://`` or ``https://`` before it. The port is 2101, and 443
            for https.
        mountpoint: Which of the caster's streams.
        user: User name, where one is needed.
        password: Password, where one is needed.
        gga: Seconds between two positions (NMEA GGA) that are sent to the caster; None sends none. Network
            services need it: they compute corrections for where you are.
        position: Gives the position for that, or None while there is none; no connection is made before there
            is one. Called from another thread.
        ntrip: Version of the protocol to ask for. 1 sends the first position right behind the request, which
            some casters wait for.

    Attributes:
        host: Host and port.
        state: ``"idle"``, ``"no position"`` (it waits for one), ``"connecting"``, ``"streaming"`` or
            ``"lost"``.
        problem: Why the last connection ended, or None.
        gga_sent: How many positions were sent while corrections came.

    Raises:
        ValueError: That is no address of a caster, or an argument has a line break.
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
        self._again_at = self._heard_at = 0.0
        self._closed = threading.Event()

    def read(self, timeout: float = 0.0) -> bytes:
        """The next frame; nothing if none comes in time, or it is closed.

        Args:
            timeout: Seconds to wait for it.

        Raises:
            CasterError: It could not be reached, or refused, before it had ever accepted the request.
            ImportError: The extra ``rtk`` is not installed.
        """
        until = time.monotonic() + timeout
        while not self._closed.is_set():
            frame = self._next(until)
            if frame or time.monotonic() >= until:
                return frame
        return b""

    def __iter__(self) -> Iterator[bytes]:
        """The frames until it is closed, which another thread may do; waits for each."""
        while not self._closed.is_set():
            if frame := self.read(TIMEOUT):
                yield frame

    def close(self) -> None:
        """Ends the connection, for good."""
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
            raw, told = connection.queue.get(timeout=max(until - time.monotonic(), 0))
        except Empty:
            if time.monotonic() - self._heard_at > NO_CORRECTION_TIMEOUT:
                self._ended(connection, TIMED_OUT)
            return b""
        if isinstance(raw, list):
            connection.mountpoints = [row[0] for row in raw]
        elif not raw:
            self._ended(connection, told)
        elif raw.startswith(b"$"):
            self.gga_sent += 1
        else:
            self.state, self.problem = "streaming", None
            self._pause = FIRST_PAUSE
            self._was_accepted = True
            self._heard_at = time.monotonic()
            connection.has_streamed = True
            return bytes(raw)
        return b""

    def _connect(self, until: float) -> _Connection | None:
        """Makes a connection, if it is time; waits for that, but not longer than ``until``."""
        wait = self._again_at - time.monotonic()
        if wait <= 0 and self._request["ggainterval"] != -1 and self._position() is None:
            self.state, wait = "no position", POSITION_INTERVAL
        if wait > 0:
            self._closed.wait(max(min(wait, until - time.monotonic()), 0))
            return None
        self.state = "connecting"
        self._heard_at = time.monotonic()
        self._connection = _Connection(self._request, self._position)
        return self._connection

    def _ended(self, connection: _Connection, told: str | None) -> None:
        if self._closed.is_set():
            return
        self._connection = None
        connection.close()
        self.problem = self._why(connection, told)
        if not (self._was_accepted or connection.is_accepted):
            self.state = "idle"
            raise CasterError(self.problem)
        self._was_accepted = True
        self.state = "lost"
        self._again_at = time.monotonic() + self._pause
        self._pause = min(2 * self._pause, MAX_PAUSE)

    def _why(self, connection: _Connection, told: str | None) -> str:
        """Why a connection has ended, in a sentence."""
        code, mountpoint, told = connection.code, self._request["mountpoint"], told or ""
        if code is None and told.startswith(NO_STATUS):
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
            return f"{self.host} refused: {(told or str(code)).removeprefix('Connection failed ')}"
        if code == 200 and told.startswith(TIMED_OUT):
            return f"{self.host} is connected, but sends no corrections"
        if code == 200:
            before = "" if connection.has_streamed else " before the first correction"
            return f"{self.host} has hung up{before}"
        text = told or "it has hung up"
        if text.startswith(("IndexError", "ValueError", "UnicodeDecodeError")):
            return no_caster(self.host)
        # It tells the exception as Python writes it: ConnectionRefusedError(111, 'Connection refused').
        words = re.search(r"""['"](.+)['"]""", text)
        return f"cannot reach {self.host}: {words[1] if words else text}"


def no_answer(host: Address | str) -> str:
    """That a caster closes the connection before it answers."""
    return (
        f"{host} hangs up without an answer; check the port, and whether the address needs https://"
    )


def no_access(host: Address | str) -> str:
    """That a caster refuses the user."""
    return f"{host} does not let that user in (401); check user and password"


def no_caster(host: Address | str) -> str:
    """That something else answers."""
    return f"what answers at {host} is no NTRIP caster"


class _Connection:
    """One connection, with the thread of pygnssutils behind it; to which it is the application."""

    def __init__(self, request: dict[str, Any], position: Callable[[], Position | None]) -> None:
        pygnssutils = require("pygnssutils", "rtk", "to get corrections from a caster")
        #: What came: a frame or GGA, and its parsed form; or nothing, and why it ended or None.
        self.queue: Queue[tuple[Any, Any]] = Queue(QUEUE_SIZE)
        self.mountpoints: list[str] = []
        self.has_streamed = False
        self._position = position
        self._stop = threading.Event()
        # It makes loggers print, which is for the application to decide.
        logging.getLogger("pygnssutils").addHandler(_NOWHERE)
        loggers = [logging.getLogger(name) for name in ("pyrtcm", "pyspartn")]
        before = [list(logger.handlers) for logger in loggers]
        # Tries once: when to try again is decided above.
        self._client = _client_class(pygnssutils)(app=self, retries=0, timeout=TIMEOUT)
        for logger, handlers in zip(loggers, before, strict=True):
            logger.handlers[:] = handlers
        self._client.run(**request, output=self.queue, stopevent=self._stop)

    @property
    def code(self) -> int | None:
        """The status that the caster answered with, None if it did not."""
        found: int | None = self._client.status.get("code")
        return found

    @property
    def is_sourcetable(self) -> bool:
        """Whether the caster answered with the list of what it has, as to an unknown mountpoint."""
        return self.code is not None and bool(self._client.is_sourcetable)

    @property
    def is_accepted(self) -> bool:
        """Whether the caster has accepted the request."""
        return self.code == 200 and not self.is_sourcetable

    def close(self) -> None:
        """Ends it; the thread follows when it wakes up, within ``TIMEOUT``."""
        self._client.stop()
        # It may wait for room, or, when the caster has hung up, fill it with nothing as fast as it can.
        with contextlib.suppress(Empty):
            while True:
                self.queue.get_nowait()
        # So may somebody who reads.
        with contextlib.suppress(Full):
            self.queue.put_nowait((b"", None))

    # What pygnssutils asks of an application

    def dialog(self, _: str) -> _Connection:
        """Where to tell how it goes."""
        return self

    def set_controls(self, connected: bool, message: tuple[str, str]) -> None:
        """It tells how it goes."""
        if not connected:
            self.queue.put((b"", message[0]))

    def get_coordinates(self) -> dict[str, Any]:
        """It asks where we are."""
        at = self._position()
        if at is None:
            raise ValueError("no position")  # it sends none then
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
                # The caster has hung up. The client itself would wait and repeat the request,
                # without a word to `Caster`.
                raise ConnectionResetError
            return 0

        def _close_connection(self, sock: Any) -> None:
            super()._close_connection(sock)
            # The client leaves a socket open whose other end is gone, because its shutdown fails.
            if sock is not None:
                sock.close()

    return Client
