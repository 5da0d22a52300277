"""Servers: virtual devices in real time for other programs, on a pseudo-terminal or TCP."""

from __future__ import annotations

import contextlib
import errno
import math
import os
import select
import selectors
import socket
import struct
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from xbus.sim.device import SimulatedDevice

__all__ = ["STEP_TIME", "PtyServer", "Server", "TcpServer", "serve", "serving"]

#: Seconds to wait for bytes before the device's time advances.
STEP_TIME = 0.01
#: The most seconds by which a step advances the device's time. The rest of a longer pause is skipped.
CATCH_UP = 1.0
#: Bytes of one read, and the most bytes to read in a step.
PIECE, MOST = 1 << 12, 1 << 16
#: Maximum bytes queued for a client that does not read; further output is dropped.
QUEUE_SIZE = 1 << 16
#: Linux: the ioctl request for terminal settings with numeric speeds, and the size of these settings.
TCGETS2, TERMIOS2_SIZE = 0x802C542A, 44


class Server(ABC):
    """Serves a virtual device to one client at a time, in the thread that calls `step`.

    Output without a client is dropped, as on a UART, so a client never receives old bytes. If a client does
    not read, output is dropped once 64 KiB are queued for it.

    Args:
        device: The virtual device. Its time follows the clock. A pause between steps that is longer than a
            second, for example while the process is stopped, counts as one second.
        clock: Returns the time in seconds, from any origin.
        speed: Seconds of device time per second of the clock, or a function that returns them.

    Attributes:
        device: The virtual device.
        has_client: Whether a client is connected.
        lost: Bytes that were dropped because the client did not read.
    """

    def __init__(
        self,
        device: SimulatedDevice,
        *,
        clock: Callable[[], float] = time.monotonic,
        speed: float | Callable[[], float] = 1.0,
    ) -> None:
        if not callable(speed) and not 0 < speed < math.inf:
            raise ValueError(f"speed must be a factor above 0, not {speed}")
        self.device = device
        self._speed = speed
        self.has_client = False
        self.lost = 0
        self._clock = clock
        self._last_step = clock()
        self._queue = bytearray()
        self._selector = selectors.DefaultSelector()

    @property
    @abstractmethod
    def port(self) -> str | None:
        """The port that a client opens; None while the plug is out."""

    def step(self, timeout: float = STEP_TIME) -> None:
        """Waits for bytes from the client, advances the device's time, and exchanges bytes.

        The device sends nothing between two steps, so call it about every 10 ms.

        Args:
            timeout: The longest wait in seconds.
        """
        self._selector.select(timeout)
        data = self._receive()
        now = self._clock()
        speed = self._speed() if callable(self._speed) else self._speed
        self.device.advance(min(now - self._last_step, CATCH_UP) * speed)
        self._last_step = now
        rate = self._baudrate()
        if data and self.device.plugged:
            self.device.write(data, baudrate=rate)
        self._send(self.device.read(baudrate=rate))

    def close(self) -> None:
        """Disconnects the client and releases the port."""
        self._set_client(False)
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
                self._set_client(True)
                return received
            except OSError:
                piece = b""
            if not piece:
                self._set_client(False)
                return received
            self._set_client(True)
            received += piece
        return received

    def _send(self, data: bytes) -> None:
        if not self.has_client:
            return
        if len(self._queue) > QUEUE_SIZE:
            self.lost += len(data)
        else:
            self._queue += data
        try:
            while self._queue:
                del self._queue[: self._write(self._queue)]
        except BlockingIOError:
            pass
        except OSError:
            self._set_client(False)

    def _set_client(self, has_client: bool) -> None:
        if has_client != self.has_client:
            self.has_client = has_client
            self._queue.clear()
            if has_client:
                self._connected()
            else:
                self._disconnect()

    def _baudrate(self) -> int | None:
        """Returns the baud rate of the client's port; None if any rate works."""
        return None

    @abstractmethod
    def _read(self) -> bytes:
        """Returns bytes from the client; without a client, returns none or raises an OSError.

        Raises:
            BlockingIOError: A client is connected and has sent nothing.
        """

    @abstractmethod
    def _write(self, data: bytearray) -> int:
        """Writes to the client, and returns the number of bytes written.

        Raises:
            BlockingIOError: Nothing can be written now.
        """

    @abstractmethod
    def _connected(self) -> None:
        """Prepares the port for a new client."""

    @abstractmethod
    def _disconnect(self) -> None:
        """Cleans up after the client has left, or disconnects it."""


class PtyServer(Server):
    """Serves a virtual device on a pseudo-terminal, which programs open like a serial port.

    The terminal is in raw mode when it appears, and again after each client. A device with a baud rate
    (`SimulatedDevice.is_serial`) understands a client only at its own rate; another device works at any
    rate, as on USB. While the device's plug is out the port does not exist: clients see it hang up. A new
    port appears when the plug is in again.

    Args:
        device: The virtual device.
        link: Path of a symbolic link to the current port. An existing link is replaced.
        clock: Returns the time in seconds, from any origin.
        speed: Seconds of device time per second of the clock, or a function that returns them.

    Raises:
        NotImplementedError: The system has no pseudo-terminals, for example Windows.
        FileExistsError: ``link`` exists and is not a symbolic link.
        OSError: The pseudo-terminal or the link cannot be created.

    Example:
        >>> import serial, xbus
        >>> from xbus.sim import PtyServer
        >>> with PtyServer(xbus.SimulatedDevice("MTi-630")) as server:
        ...     port = serial.Serial(server.port, timeout=0)
        ...     while not (received := port.read(5)):
        ...         server.step()
        >>> received.hex(" ")
        'fa ff 3e 00 c3'
    """

    def __init__(
        self,
        device: SimulatedDevice,
        *,
        link: str | os.PathLike[str] | None = None,
        clock: Callable[[], float] = time.monotonic,
        speed: float | Callable[[], float] = 1.0,
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
        """The path of the port, or of the link to it; None while the plug is out."""
        return None if self._master is None else str(self._link or self._path)

    def step(self, timeout: float = STEP_TIME) -> None:
        """Waits for bytes from the client, advances the device's time, and exchanges bytes.

        Args:
            timeout: The longest wait in seconds.
        """
        super().step(timeout)
        if self.device.plugged and self._master is None:
            self._plug_in()
        elif not self.device.plugged:
            self._unplug()

    def close(self) -> None:
        """Disconnects the client and removes the port."""
        self._unplug()
        super().close()

    def _plug_in(self) -> None:
        import termios

        self._master, slave = os.openpty()
        try:
            termios.tcsetattr(slave, termios.TCSANOW, _raw(termios.tcgetattr(slave)))
            self._path = os.ttyname(slave)
        finally:
            # While this end is open, the other end cannot detect that a client has left. The settings belong
            # to the pair, and remain.
            os.close(slave)
        os.set_blocking(self._master, False)
        if self._link is not None:
            _make_link(self._link, self._path)

    def _unplug(self) -> None:
        if self._master is None:
            return
        self._set_client(False)
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
        # Without a client this raises EIO on Linux, and returns nothing on macOS.
        return b"" if self._master is None else os.read(self._master, PIECE)

    def _write(self, data: bytearray) -> int:
        assert self._master is not None  # noqa: S101 - a client has opened it
        return os.write(self._master, data)

    def _connected(self) -> None:
        assert self._master is not None  # noqa: S101 - a client has opened it
        # The terminal is registered only while a client has it open: without one it is always ready.
        self._selector.register(self._master, selectors.EVENT_READ)

    def _disconnect(self) -> None:
        import termios

        assert self._master is not None  # noqa: S101 - a client had opened it
        self._selector.unregister(self._master)
        termios.tcflush(self._master, termios.TCOFLUSH)
        settings = termios.tcgetattr(self._master)
        # To set a mode sets the rate too, and the next client may have set another one in the meantime.
        if (raw := _raw(settings)) != settings and _has_no_client(self._master):
            termios.tcsetattr(self._master, termios.TCSANOW, raw)


def _raw(settings: list[Any]) -> list[Any]:
    """Returns the settings with which a terminal passes all bytes unchanged, and a read waits for one.

    ``tty.setraw`` leaves INLCR, IGNCR and PARMRK as they are in Python 3.11.
    """
    import termios as t

    read, write, control, local, *rates, characters = settings
    read &= ~(
        t.BRKINT | t.ICRNL | t.IGNBRK | t.IGNCR | t.INLCR | t.INPCK | t.ISTRIP | t.IXON | t.PARMRK
    )
    local &= ~(t.ECHO | t.ICANON | t.IEXTEN | t.ISIG)
    characters = [*characters]
    characters[t.VMIN], characters[t.VTIME] = 1, 0
    return [read, write & ~t.OPOST, control, local, *rates, characters]


def _has_no_client(master: int) -> bool:
    """Returns whether no program has the other end of a pseudo-terminal open."""
    poll = select.poll()
    poll.register(master, 0)
    return any(event & select.POLLHUP for _, event in poll.poll(0))


def _speed(terminal: int) -> int:
    """Returns the baud rate that is set on a terminal."""
    if sys.platform == "linux":
        import fcntl

        # termios.tcgetattr has no value for rates without a constant, such as 76800.
        settings = fcntl.ioctl(terminal, TCGETS2, bytes(TERMIOS2_SIZE))
        return int(struct.unpack("=I", settings[-4:])[0])
    import termios

    return int(termios.tcgetattr(terminal)[5])


def _make_link(link: Path, target: str) -> None:
    if link.exists() and not link.is_symlink():
        raise FileExistsError(errno.EEXIST, "the path exists and is not a symbolic link", str(link))
    # The link is created under another name and moved, so that the path exists at all times.
    new = link.with_name(f".{link.name}.{os.getpid()}")
    new.symlink_to(target)
    new.replace(link)


class TcpServer(Server):
    """Serves a virtual device on TCP, to one client at a time.

    Further connections are closed, and all connections while the device's plug is out. Baud rates have no
    effect.

    Args:
        device: The virtual device.
        host: Address or name to listen on.
        port: TCP port to listen on; 0 chooses a free port.
        clock: Returns the time in seconds, from any origin.
        speed: Seconds of device time per second of the clock, or a function that returns them.
        idle_timeout: Seconds after which the server disconnects a client that neither sends nor accepts a
            byte; None: never. A client that has lost its network blocks the port for others.

    Raises:
        OSError: The address cannot be used, or the port is in use.

    Example:
        >>> import serial, xbus
        >>> from xbus.sim import TcpServer
        >>> with TcpServer(xbus.SimulatedDevice("MTi-630")) as server:
        ...     port = serial.serial_for_url(server.port, timeout=0)
        ...     while not (received := port.read(5)):
        ...         server.step()
        >>> received.hex(" ")
        'fa ff 3e 00 c3'
    """

    def __init__(
        self,
        device: SimulatedDevice,
        host: str = "127.0.0.1",
        port: int = 0,
        *,
        clock: Callable[[], float] = time.monotonic,
        speed: float | Callable[[], float] = 1.0,
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
        """The URL that `xbus.connect` and pyserial accept: ``socket://HOST:PORT``."""
        return self._port

    def step(self, timeout: float = STEP_TIME) -> None:
        """Waits for bytes from the client, advances the device's time, and exchanges bytes.

        Args:
            timeout: The longest wait in seconds.
        """
        super().step(timeout)
        if self._clock() - self._active_at > self._idle_timeout:
            self._set_client(False)

    def close(self) -> None:
        """Disconnects the client and stops listening."""
        super().close()
        self._listener.close()

    def _read(self) -> bytes:
        if not self.device.plugged:
            self._reject_connections()
            return b""
        if self._client is None:
            try:
                self._client, _ = self._listener.accept()
            except BlockingIOError:
                return b""
            self._set_client(True)
        try:
            data = self._client.recv(PIECE)
        except BlockingIOError:
            self._reject_connections()
            raise
        self._active_at = self._clock()
        return data

    def _reject_connections(self) -> None:
        """Closes all connections that wait to be accepted."""
        while True:
            try:
                self._listener.accept()[0].close()
            except OSError:
                return

    def _write(self, data: bytearray) -> int:
        assert self._client is not None  # noqa: S101 - a client is connected
        sent = self._client.send(data)
        self._active_at = self._clock()
        return sent

    def _connected(self) -> None:
        assert self._client is not None  # noqa: S101 - a client is connected
        self._client.setblocking(False)
        self._client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        # A client that has lost the network must not block the port for others.
        self._client.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        self._selector.register(self._client, selectors.EVENT_READ)
        self._active_at = self._clock()

    def _disconnect(self) -> None:
        assert self._client is not None  # noqa: S101 - a client was connected
        self._selector.unregister(self._client)
        self._client.close()
        self._client = None


@contextlib.contextmanager
def serving(
    device: SimulatedDevice,
    *,
    tcp: bool = False,
    link: str | os.PathLike[str] | None = None,
    speed: float | Callable[[], float] = 1.0,
    step: float = STEP_TIME,
) -> Iterator[str]:
    """Serves a virtual device in a thread, for the duration of a ``with`` block.

    Args:
        device: The virtual device. Do not call `SimulatedDevice.advance` and `SimulatedDevice.read`
            meanwhile: the server calls them.
        tcp: Serves on TCP at 127.0.0.1 instead of a pseudo-terminal.
        link: Path of a symbolic link to the pseudo-terminal.
        speed: Seconds of device time per second of real time, or a function that returns them.
        step: The longest time in seconds between two moments at which the device sends. Each of them costs
            processor time.

    Yields:
        The port, a path or URL that `xbus.connect` and pyserial accept.

    Raises:
        NotImplementedError: The system has no pseudo-terminals, for example Windows: use ``tcp=True``.
        OSError: The pseudo-terminal or socket cannot be created.

    Example:
        >>> import xbus
        >>> from xbus.sim import serving
        >>> with serving(xbus.SimulatedDevice("MTi-630")) as port, xbus.connect(port) as device:
        ...     "quaternion" in device.read_sample()
        True
    """
    if tcp and link is not None:
        raise ValueError("link needs a pseudo-terminal: leave out link or tcp")
    server: Server = (
        TcpServer(device, speed=speed) if tcp else PtyServer(device, link=link, speed=speed)
    )
    with server:
        stop = threading.Event()
        thread = threading.Thread(target=serve, args=(server, stop.is_set), kwargs={"step": step})
        port = server.port
        thread.start()
        try:
            yield str(port)
        finally:
            stop.set()
            thread.join()


def serve(
    server: Server,
    until: Callable[[], bool],
    on_port: Callable[[str], object] | None = None,
    *,
    step: float = STEP_TIME,
) -> None:
    """Runs a server in real time, in the calling thread.

    Args:
        server: The server; it remains open.
        until: Called after each step; serving ends when it returns True.
        on_port: Called with the port at the start, and again whenever the port changes.
        step: The longest wait in seconds of a step, as in `serving`.

    Example:
        >>> import xbus
        >>> from xbus.sim import TcpServer, serve
        >>> device = xbus.SimulatedDevice("MTi-630")
        >>> with TcpServer(device) as server:
        ...     serve(server, until=lambda: device.time >= 0.1)
        >>> device.state.value
        'wakeup'
    """
    port = None
    while True:
        if server.port != port:
            port = server.port
            if port is not None and on_port is not None:
                on_port(port)
        if until():
            return
        server.step(step)
