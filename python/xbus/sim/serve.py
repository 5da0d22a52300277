"""Virtual devices in real time, for any program: on a pseudo-terminal, or on TCP."""

from __future__ import annotations

import contextlib
import errno
import math
import os
import selectors
import socket
import struct
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from xbus.sim.device import SimulatedDevice

__all__ = ["PtyServer", "Server", "TcpServer", "serve", "serving"]

#: Seconds between two looks at the clock, where no bytes come earlier.
STEP = 0.01
#: Seconds that are made up for at most. After a longer pause the device has missed the rest of it.
CATCH_UP = 1.0
#: Bytes read at a time, and how many in a step at most.
PIECE, MOST = 1 << 12, 1 << 16
#: Bytes that wait for a client who does not read. While more wait, what the device sends is lost.
QUEUE = 1 << 16
#: Linux' request for a terminal's settings with the speeds as numbers, and how many bytes these are.
TCGETS2, TERMIOS2_SIZE = 0x802C542A, 44


class Server(ABC):
    """Serves a virtual device to one client at a time, without a thread of its own.

    While nobody is there, what the device sends is thrown away, as on a UART: a client never finds old
    bytes. A client who is there and does not read loses whole steps of output, once 64 KiB wait.

    Args:
        device: The virtual device. Its time goes with the clock; a pause of more than a second, as when
            the process was stopped, counts as one second.
        clock: Seconds, from any beginning.
        speed: Seconds of device time per second of the clock.

    Attributes:
        device: The virtual device.
        is_used: Whether a client is there.
        lost: How many bytes were lost because the client did not read.
    """

    def __init__(
        self,
        device: SimulatedDevice,
        *,
        clock: Callable[[], float] = time.monotonic,
        speed: float = 1.0,
    ) -> None:
        if not 0 < speed < math.inf:
            raise ValueError(f"speed is a factor above 0, not {speed}")
        self.device = device
        self._speed = speed
        self.is_used = False
        self.lost = 0
        self._clock = clock
        self._then = clock()
        self._queue = bytearray()
        self._selector = selectors.DefaultSelector()

    @property
    @abstractmethod
    def port(self) -> str | None:
        """What a client opens; None while the plug is pulled and the port does not exist."""

    def step(self, timeout: float = STEP) -> None:
        """Waits for bytes from the client, at most ``timeout`` seconds, and moves device and bytes on.

        Call it at least every 10 ms or so: the device sends nothing in between.
        """
        self._selector.select(timeout)
        data = self._receive()
        now = self._clock()
        self.device.advance(min(now - self._then, CATCH_UP) * self._speed)
        self._then = now
        rate = self._baudrate()
        if data and self.device.plugged:
            self.device.write(data, baudrate=rate)
        self._send(self.device.read(baudrate=rate))

    def close(self) -> None:
        """Hangs up and frees the port."""
        self._set_used(False)
        self._selector.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _receive(self) -> bytes:
        received = b""
        while len(received) < MOST:
            try:
                piece = self._read()
            except BlockingIOError:
                self._set_used(True)
                return received
            except OSError:
                piece = b""
            if not piece:
                self._set_used(False)
                return received
            self._set_used(True)
            received += piece
        return received

    def _send(self, data: bytes) -> None:
        if not self.is_used:
            return
        if len(self._queue) > QUEUE:
            self.lost += len(data)
        else:
            self._queue += data
        try:
            while self._queue:
                del self._queue[: self._write(self._queue)]
        except BlockingIOError:
            pass
        except OSError:
            self._set_used(False)

    def _set_used(self, used: bool) -> None:
        if used != self.is_used:
            self.is_used = used
            self._queue.clear()
            if used:
                self._enter()
            else:
                self._leave()

    def _baudrate(self) -> int | None:
        """The rate that the client has set, where it means something."""
        return None

    @abstractmethod
    def _read(self) -> bytes:
        """Bytes from the client; none, or an OSError, where nobody is there.

        Raises:
            BlockingIOError: A client is there, and nothing has come.
        """

    @abstractmethod
    def _write(self, data: bytearray) -> int:
        """How many bytes went to the client.

        Raises:
            BlockingIOError: None did, for now.
        """

    @abstractmethod
    def _enter(self) -> None:
        """A client has come."""

    @abstractmethod
    def _leave(self) -> None:
        """The client has gone, or has to go."""


class PtyServer(Server):
    """Serves a virtual device on a pseudo-terminal, which programs open like a serial port.

    The terminal is raw before anybody knows its name, and again when a client has left. Where the device
    `is_serial`, the speed that the client sets counts; else any does, as on USB. While the device's plug is
    pulled there is no port, and clients see it hang up; then there is a new one.

    Args:
        device: The virtual device.
        link: A name that always leads to the port: a symbolic link, replaced where it is there.
        clock: Seconds, from any beginning.
        speed: Seconds of device time per second of the clock.

    Raises:
        NotImplementedError: The system has no pseudo-terminals, as Windows.
        FileExistsError: ``link`` is a file, not a link.
        OSError: No pseudo-terminal or no link can be made.
    """

    def __init__(
        self,
        device: SimulatedDevice,
        *,
        link: str | os.PathLike[str] | None = None,
        clock: Callable[[], float] = time.monotonic,
        speed: float = 1.0,
    ) -> None:
        if not hasattr(os, "openpty"):
            raise NotImplementedError("this system has no pseudo-terminals: serve on TCP (--tcp 0)")
        super().__init__(device, clock=clock, speed=speed)
        self._link = None if link is None else Path(link)
        self._master: int | None = None
        try:
            self._plug_in()
        except BaseException:
            self.close()
            raise

    @property
    def port(self) -> str | None:
        """The path of the port, or the link to it; None while the plug is pulled."""
        return None if self._master is None else str(self._link or self._path)

    def step(self, timeout: float = STEP) -> None:
        """Waits for bytes from the client, at most ``timeout`` seconds, and moves device and bytes on."""
        super().step(timeout)
        if self.device.plugged and self._master is None:
            self._plug_in()
        elif not self.device.plugged:
            self._unplug()

    def close(self) -> None:
        """Hangs up and removes the port."""
        self._unplug()
        super().close()

    def _plug_in(self) -> None:
        import tty

        self._master, slave = os.openpty()
        try:
            tty.setraw(slave)
            self._path = os.ttyname(slave)
        finally:
            # Only then is it seen when nobody has it open. The settings stay: they belong to the pair.
            os.close(slave)
        os.set_blocking(self._master, False)
        if self._link is not None:
            _make_link(self._link, self._path)

    def _unplug(self) -> None:
        if self._master is None:
            return
        self._set_used(False)
        link = self._link
        if link is not None and link.is_symlink() and link.readlink() == Path(self._path):
            link.unlink()
        os.close(self._master)
        self._master = None

    def _baudrate(self) -> int | None:
        if self._master is None or not self.device.is_serial:
            return None
        return _speed(self._master)

    def _read(self) -> bytes:
        # Fails while nobody has the port open: EIO on Linux, nothing on macOS.
        return b"" if self._master is None else os.read(self._master, PIECE)

    def _write(self, data: bytearray) -> int:
        assert self._master is not None  # noqa: S101 - nobody is there without a port
        return os.write(self._master, data)

    def _enter(self) -> None:
        assert self._master is not None  # noqa: S101 - nobody comes without a port
        # Not before: a terminal that nobody has open is always ready, to say so.
        self._selector.register(self._master, selectors.EVENT_READ)

    def _leave(self) -> None:
        import termios
        import tty

        assert self._master is not None  # noqa: S101 - somebody was there
        self._selector.unregister(self._master)
        termios.tcflush(self._master, termios.TCOFLUSH)
        tty.setraw(self._master, termios.TCSANOW)


def _speed(terminal: int) -> int:
    """The baud rate that is set on a terminal."""
    if sys.platform == "linux":
        import fcntl

        # Python's own function does not tell rates that have no constant, such as 76800.
        settings = fcntl.ioctl(terminal, TCGETS2, bytes(TERMIOS2_SIZE))
        return int(struct.unpack("=I", settings[-4:])[0])
    import termios

    return int(termios.tcgetattr(terminal)[5])


def _make_link(link: Path, target: str) -> None:
    if link.exists() and not link.is_symlink():
        raise FileExistsError(errno.EEXIST, "it is there and is no link", str(link))
    # Never missing in between: it is made under another name and moved.
    new = link.with_name(f".{link.name}.{os.getpid()}")
    new.symlink_to(target)
    new.replace(link)


class TcpServer(Server):
    """Serves a virtual device on TCP, to one client at a time; another one is turned away.

    Baud rates mean nothing here. While the device's plug is pulled, all are turned away.

    Args:
        device: The virtual device.
        host: Address or name to listen on.
        port: Number to listen on; 0 picks one that is free.
        clock: Seconds, from any beginning.
        speed: Seconds of device time per second of the clock.
        idle_timeout: Seconds after which the server disconnects a client that neither sends nor takes a
            byte; None: never. A client that has lost its network would keep all others out.

    Raises:
        OSError: The address cannot be used, or the port is taken.
    """

    def __init__(
        self,
        device: SimulatedDevice,
        host: str = "127.0.0.1",
        port: int = 0,
        *,
        clock: Callable[[], float] = time.monotonic,
        speed: float = 1.0,
        idle_timeout: float | None = None,
    ) -> None:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        self._listener = socket.create_server((host, port), family=family)
        self._listener.setblocking(False)
        host, port = self._listener.getsockname()[:2]
        self._port = f"socket://[{host}]:{port}" if ":" in host else f"socket://{host}:{port}"
        self._client: socket.socket | None = None
        self._idle_timeout = math.inf if idle_timeout is None else idle_timeout
        self._active_at = 0.0
        super().__init__(device, clock=clock, speed=speed)
        self._selector.register(self._listener, selectors.EVENT_READ)

    @property
    def port(self) -> str:
        """The URL for pyserial: ``socket://HOST:PORT``."""
        return self._port

    def step(self, timeout: float = STEP) -> None:
        """Waits for bytes from the client, at most ``timeout`` seconds, and moves device and bytes on."""
        super().step(timeout)
        if self._clock() - self._active_at > self._idle_timeout:
            self._set_used(False)

    def close(self) -> None:
        """Hangs up and stops listening."""
        super().close()
        self._listener.close()

    def _read(self) -> bytes:
        if not self.device.plugged:
            self._turn_away()
            return b""
        if self._client is None:
            try:
                self._client, _ = self._listener.accept()
            except BlockingIOError:
                return b""
            self._set_used(True)
        try:
            data = self._client.recv(PIECE)
        except BlockingIOError:
            self._turn_away()
            raise
        self._active_at = self._clock()
        return data

    def _turn_away(self) -> None:
        """Hangs up on whoever waits to be let in."""
        while True:
            try:
                self._listener.accept()[0].close()
            except OSError:
                return

    def _write(self, data: bytearray) -> int:
        assert self._client is not None  # noqa: S101 - a client is there
        sent = self._client.send(data)
        self._active_at = self._clock()
        return sent

    def _enter(self) -> None:
        assert self._client is not None  # noqa: S101 - a client has come
        self._client.setblocking(False)
        self._client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        # Who has lost the network would keep all others out.
        self._client.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        self._selector.register(self._client, selectors.EVENT_READ)
        self._active_at = self._clock()

    def _leave(self) -> None:
        assert self._client is not None  # noqa: S101 - a client was there
        self._selector.unregister(self._client)
        self._client.close()
        self._client = None


@contextlib.contextmanager
def serving(
    device: SimulatedDevice,
    *,
    tcp: bool = False,
    link: str | os.PathLike[str] | None = None,
    speed: float = 1.0,
) -> Iterator[str]:
    """Serves a virtual device in a thread, for the length of a ``with`` block.

    Args:
        device: The virtual device. Do not call `advance` and `read` meanwhile: the server does.
        tcp: Whether on TCP, on this machine, and not on a pseudo-terminal.
        link: Path of a symbolic link that always leads to the pseudo-terminal.
        speed: Seconds of device time per second of real time.

    Yields:
        The port, as `xbus.connect` and pyserial take it.

    >>> import xbus
    >>> from xbus.sim import serving
    >>> with serving(xbus.SimulatedDevice("MTi-630")) as port, xbus.connect(port) as device:
    ...     "quaternion" in device.read_sample()
    True
    """
    if tcp and link is not None:
        raise ValueError("a link leads to a pseudo-terminal; with tcp there is none")
    made: Server = (
        TcpServer(device, speed=speed) if tcp else PtyServer(device, link=link, speed=speed)
    )
    with made as server:
        done = threading.Event()
        thread = threading.Thread(target=serve, args=(server, done.is_set))
        port = server.port
        thread.start()
        try:
            yield str(port)
        finally:
            done.set()
            thread.join()


def serve(
    server: Server,
    until: Callable[[], bool],
    tell: Callable[[str], object] = lambda port: None,  # noqa: ARG005 - nobody wants to know
) -> None:
    """Serves in real time.

    Args:
        server: What serves; it stays open.
        until: Called about every 10 ms: whether that is all.
        tell: Called with the port, at once and each time there is a new one.
    """
    port = None
    while True:
        if server.port != port:
            port = server.port
            if port is not None:
                tell(port)
        if until():
            return
        server.step()
