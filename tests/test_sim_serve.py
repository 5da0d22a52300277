"""Virtual devices on pseudo-terminals and on TCP, as other programs see them."""

from __future__ import annotations

import os
import selectors
import socket
import termios
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import serial

import xbus
from xbus.sim.serve import QUEUE_SIZE, PtyServer, Server, TcpServer, serve


class Fake:
    """A device that sends back what it receives, and other bytes that a test adds."""

    def __init__(self, baudrate: int | None = None) -> None:
        self.is_serial, self.plugged, self.time = baudrate is not None, True, 0.0
        self.sends = b""
        self.rates: list[int | None] = []
        self.steps: list[float] = []

    def write(self, data: bytes, baudrate: int | None = None) -> None:
        self.sends += data
        self.rates.append(baudrate)

    def read(self, baudrate: int | None = None) -> bytes:
        sent, self.sends = self.sends, b""
        return sent

    def advance(self, dt: float) -> None:
        self.time += dt
        self.steps.append(dt)


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


def on_pty(device: Any, **options: Any) -> PtyServer:
    return PtyServer(device, **options)


def on_tcp(device: Any, **options: Any) -> TcpServer:
    return TcpServer(device, **options)


@pytest.fixture(params=[on_pty, on_tcp])
def server(request: pytest.FixtureRequest) -> Iterator[Server]:
    with request.param(Fake()) as server:
        yield server


def open_port(server: Server, **options: Any) -> Any:
    assert server.port is not None
    return serial.serial_for_url(server.port, timeout=5, **options)


def step_until(server: Server, done: Callable[[], bool]) -> None:
    """Steps until a condition holds: the kernel needs time to deliver bytes."""
    for _ in range(1000):
        if done():
            return
        server.step()
    raise AssertionError("it never came to that")


def exchange(server: Server, client: Any, data: bytes) -> bytes:
    """Returns what the fake device sends back."""
    client.write(data)
    step_until(server, lambda: client.in_waiting > 0)
    return bytes(client.read(len(data)))


def _has_ipv6() -> bool:
    try:
        socket.create_server(("::1", 0), family=socket.AF_INET6).close()
    except OSError:
        return False
    return True


needs_ipv6 = pytest.mark.skipif(not _has_ipv6(), reason="no IPv6 here")

ALL_BYTES = bytes(range(256))


# Both servers


def test_all_bytes_go_both_ways_unchanged(server: Server) -> None:
    with open_port(server) as client:
        assert exchange(server, client, ALL_BYTES) == ALL_BYTES


def test_a_new_client_receives_no_old_bytes(server: Server) -> None:
    device: Any = server.device
    device.sends = b"before anybody came"
    server.step(0)
    with open_port(server) as client:
        assert exchange(server, client, b"first") == b"first"
        device.sends = b"while the first one was leaving"
        server.step(0)
    step_until(server, lambda: not server.has_client)
    device.sends = b"without a client"
    server.step(0)
    with open_port(server) as client:
        assert exchange(server, client, b"second") == b"second"


def test_a_client_that_does_not_read_loses_whole_steps(server: Server) -> None:
    device: Any = server.device
    with open_port(server) as client:
        assert exchange(server, client, b"here") == b"here"
        numbers = 0
        while server.lost < 100_000:
            device.sends = b"%9d " % numbers * 5000
            numbers += 1
            server.step(0)
        assert server.lost % 50_000 == 0
        received = b""
        while server._queue:
            received += client.read(1000)
            server.step(0)
        received += client.read(50_000 * numbers - server.lost - len(received))
    words = received.split()
    assert len(received) > QUEUE_SIZE
    assert words == [b"%d" % index for index in range(len(words) // 5000) for _ in range(5000)]


def test_device_time_follows_the_clock(server: Server) -> None:
    device, clock = Fake(), Clock()
    make = on_pty if isinstance(server, PtyServer) else on_tcp
    with make(device, clock=clock) as other:
        for pause in (0.01, 0.25, 0.0, 3600.0, 0.5):
            clock.now += pause
            other.step(0)
    assert device.steps == pytest.approx([0.01, 0.25, 0.0, 1.0, 0.5])


def test_a_step_ends_when_bytes_arrive(server: Server) -> None:
    with open_port(server) as client:
        assert exchange(server, client, b"here") == b"here"
        client.write(b"again")
        server.step(60)
        assert client.read(5) == b"again"


def test_the_length_of_a_step_can_be_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    steps: list[float] = []
    with TcpServer(xbus.SimulatedDevice("MTi-630")) as server:
        monkeypatch.setattr(server, "step", steps.append)
        serve(server, until=lambda: len(steps) == 2, step=0.025)
    assert steps == [0.025, 0.025]


def test_serve_runs_in_a_thread(server: Server) -> None:
    stop = threading.Event()
    ports: list[str] = []
    thread = threading.Thread(target=serve, args=(server, stop.is_set, ports.append))
    thread.start()
    try:
        with open_port(server) as client:
            for _ in range(20):
                client.write(ALL_BYTES)
                assert client.read(256) == ALL_BYTES
    finally:
        stop.set()
        thread.join()
    assert ports == [server.port]


def test_closing_disconnects_the_client(server: Server) -> None:
    port = server.port
    with open_port(server) as client:
        assert exchange(server, client, b"here") == b"here"
        server.close()
        with pytest.raises((serial.SerialException, OSError)):
            client.read(1)
    with pytest.raises(serial.SerialException):
        serial.serial_for_url(port)


# Pseudo-terminals


def test_the_terminal_is_raw_again_after_a_client() -> None:
    with on_pty(Fake()) as server:
        assert server.port is not None
        for _ in range(2):
            terminal = os.open(server.port, os.O_RDWR | os.O_NOCTTY)
            settings = termios.tcgetattr(terminal)
            assert not settings[1] & termios.OPOST
            assert not settings[3] & (termios.ECHO | termios.ICANON | termios.ISIG)
            settings[3] |= termios.ECHO | termios.ICANON
            termios.tcsetattr(terminal, termios.TCSANOW, settings)
            step_until(server, lambda: server.has_client)
            os.close(terminal)
            step_until(server, lambda: not server.has_client)


@pytest.mark.parametrize("flag", ["", "ICRNL", "IGNCR", "INLCR", "ISTRIP", "IXON", "PARMRK"])
def test_a_client_that_sets_no_mode_gets_all_bytes(flag: str) -> None:
    data = bytes(range(256))
    with on_pty(Fake()) as server:
        with open_port(server) as client:  # whose reads do not wait
            assert exchange(server, client, b"a") == b"a"
            settings = termios.tcgetattr(client.fd)
            settings[0] |= getattr(termios, flag, 0)
            termios.tcsetattr(client.fd, termios.TCSANOW, settings)
        step_until(server, lambda: not server.has_client)
        assert server.port is not None
        terminal = os.open(server.port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        found = bytearray()

        def receive() -> bool:
            found.extend(client.read(len(data)) or b"")
            return len(found) >= len(data)

        with os.fdopen(terminal, "r+b", buffering=0) as client:
            assert client.read(1) is None  # no end of file
            client.write(data)
            step_until(server, receive)
        assert found == data


def test_a_client_that_comes_while_another_leaves_keeps_its_rate(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    device = Fake(baudrate=115_200)
    with on_pty(device) as server:
        with open_port(server, baudrate=921_600) as client:
            assert exchange(server, client, b"a") == b"a"
        clients: list[Any] = []
        read_settings = termios.tcgetattr

        def settings(terminal: int) -> list[Any]:
            found = read_settings(terminal)
            if terminal == server._master and not clients:
                clients.append(open_port(server, baudrate=115_200))
            return found

        monkeypatch.setattr("termios.tcgetattr", settings)
        step_until(server, lambda: not server.has_client)
        with clients[0] as client:
            assert exchange(server, client, b"b") == b"b"
    assert device.rates == [921_600, 115_200]


@pytest.mark.parametrize("rate", [4800, 76_800, 115_200, 921_600, 2_000_000, 3_500_000, 4_000_000])
def test_the_rate_of_a_serial_device_is_that_of_the_terminal(rate: int) -> None:
    device = Fake(baudrate=115_200)
    with on_pty(device) as server, open_port(server, baudrate=rate) as client:
        assert exchange(server, client, b"a") == b"a"
    assert device.rates == [rate]


def test_on_usb_every_rate_works() -> None:
    device = Fake()
    with on_pty(device) as server, open_port(server, baudrate=9600) as client:
        assert exchange(server, client, b"a") == b"a"
    assert device.rates == [None]


def test_a_pulled_plug_disconnects_and_a_new_port_appears(tmp_path: Path) -> None:
    device = Fake()
    link = tmp_path / "mti"
    with on_pty(device, link=link) as server:
        assert server.port == str(link)
        first = link.readlink()
        with open_port(server) as client:
            assert exchange(server, client, b"here") == b"here"
            device.plugged = False
            server.step(0)
            assert server.port is None
            assert not link.is_symlink()
            with pytest.raises((serial.SerialException, OSError)):
                client.read(1)
            server.step(0)
            # The first client still has the old terminal open.
            device.plugged = True
            server.step(0)
        assert server.port == str(link)
        assert link.readlink() != first
        with open_port(server) as client:
            assert exchange(server, client, b"again") == b"again"
    assert list(tmp_path.iterdir()) == []


def test_each_new_port_is_reported() -> None:
    device = Fake()
    ports: list[str] = []
    steps = iter(range(9))

    def until() -> bool:
        step = next(steps)
        device.plugged = step not in (2, 3)
        return step == 8

    with on_pty(device) as server:
        serve(server, until, ports.append)
        assert len(ports) == 2
        assert ports[1] == server.port


def test_a_stale_link_is_replaced_and_a_file_is_not(tmp_path: Path) -> None:
    link, file = tmp_path / "link", tmp_path / "file"
    link.symlink_to("/dev/pts/nowhere")
    file.write_text("mine")
    with on_pty(Fake(), link=link) as server:
        assert link.readlink() != Path("/dev/pts/nowhere")
        assert server.port == str(link)
        with pytest.raises(FileExistsError):
            on_pty(Fake(), link=file)
        # A link to another port is kept.
        link.unlink()
        link.symlink_to("elsewhere")
    assert link.readlink() == Path("elsewhere")
    assert file.read_text() == "mine"


def test_a_system_without_pseudo_terminals(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "openpty")
    with pytest.raises(NotImplementedError, match="--tcp"):
        on_pty(Fake())


def test_a_terminal_without_a_client_uses_no_processor_time() -> None:
    with on_pty(Fake()) as server, open_port(server) as client:
        assert exchange(server, client, b"here") == b"here"
        client.close()
        step_until(server, lambda: not server.has_client)
        # A terminal without a client is always ready, so the server must not wait for it.
        assert isinstance(server._selector, selectors.BaseSelector)
        assert not server._selector.get_map()


# TCP


def test_a_second_client_is_rejected_until_the_first_has_left() -> None:
    with on_tcp(Fake()) as server:
        address = server._listener.getsockname()
        with open_port(server) as client:
            assert exchange(server, client, b"first") == b"first"
            with socket.create_connection(address, timeout=5) as second:
                server.step(5)
                assert second.recv(1) == b""
            assert exchange(server, client, b"still") == b"still"
        with open_port(server) as client:
            assert exchange(server, client, b"next") == b"next"


def test_a_client_that_leaves_at_once_does_no_harm() -> None:
    with on_tcp(Fake()) as server:
        address = server._listener.getsockname()
        for _ in range(3):
            socket.create_connection(address, timeout=5).close()
            server.step(5)
        step_until(server, lambda: not server.has_client)
        with open_port(server) as client:
            assert exchange(server, client, b"next") == b"next"


def test_a_pulled_plug_disconnects_tcp_clients() -> None:
    device = Fake()
    with on_tcp(device) as server, open_port(server) as client:
        assert exchange(server, client, b"here") == b"here"
        device.plugged = False
        step_until(server, lambda: not server.has_client)
        with pytest.raises(serial.SerialException):
            client.read(1)
        with socket.create_connection(server._listener.getsockname(), timeout=5) as other:
            server.step(5)
            assert other.recv(1) == b""
        device.plugged = True
        with open_port(server) as again:
            assert exchange(server, again, b"again") == b"again"


def test_addresses() -> None:
    with on_tcp(Fake()) as server:
        assert server.port.startswith("socket://127.0.0.1:")
        with pytest.raises(OSError, match="in use"):
            on_tcp(Fake(), port=server._listener.getsockname()[1])


@needs_ipv6
def test_an_address_of_ipv6() -> None:
    with on_tcp(Fake(), host="::1") as server, open_port(server) as client:
        assert server.port.startswith("socket://[::1]:")
        assert exchange(server, client, b"six") == b"six"
