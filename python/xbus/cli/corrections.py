"""RTK corrections, which a thread forwards from a caster to a device: options and state."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, TypeVar

import click

from xbus.cli.failure import Failure
from xbus.errors import DeviceError, Disconnected, StateError, XbusError, XbusTimeout
from xbus.formatting import format_count

if TYPE_CHECKING:
    from xbus.device import Device

__all__ = ["Corrections", "caster_options", "check_receiver", "new_corrections"]

T = TypeVar("T")

#: Maximum seconds to wait for a correction before the thread checks whether it must end.
READ_TIMEOUT = 0.2
#: Seconds until a caster that has refused is asked again.
REFUSED_PAUSE = 60.0
#: Seconds to wait for samples that have not arrived at the end of a block.
SAMPLE_TIMEOUT = 0.01
#: Maximum seconds for the thread to end: a command waits for its answer.
JOIN_TIMEOUT = 5.0


def caster_options(*, required: bool) -> Callable[[T], T]:
    """Returns a decorator that adds the options of a caster to a command.

    Args:
        required: Whether the command needs a caster.
    """
    also = "" if required else "With --caster: "
    options = (
        click.option(
            "--caster",
            required=required,
            metavar="HOST[:PORT]",
            help=("The caster" if required else "Forward RTK corrections from this NTRIP caster")
            + ". Default port: 2101, with https:// 443.",
        ),
        click.option(
            "--mountpoint",
            metavar="NAME",
            help=f"{also}{'a' if also else 'A'} stream of the caster.",
        ),
        click.option(
            "--user",
            envvar="XBUS_NTRIP_USER",
            show_envvar=True,
            help=f"{also}{'user' if also else 'User'} name.",
        ),
        click.option(
            "--password",
            envvar="XBUS_NTRIP_PASSWORD",
            show_envvar=True,
            help=f"{also}{'password' if also else 'Password'}. Other users of this machine can see"
            " arguments, but not the environment.",
        ),
        click.option(
            "--gga",
            type=click.IntRange(min=1),
            metavar="S",
            help=f"{also}{'send' if also else 'Send'} the position of the device to the caster every S"
            " seconds, as network services require.",
        ),
        click.option(
            "--ntrip",
            type=click.Choice(["1", "2"]),
            default="2",
            show_default=True,
            help=f"{also}{'version' if also else 'Version'} of the NTRIP protocol.",
        ),
    )

    def add(command: T) -> T:
        for option in reversed(options):
            command = option(command)  # type: ignore[type-var]
        return command

    return add


def new_corrections(
    caster: str,
    mountpoint: str,
    user: str | None,
    password: str | None,
    gga: int | None,
    ntrip: str,
    *,
    persistent: bool = False,
) -> Corrections:
    """Returns the corrections of a caster; nothing is contacted yet.

    Args:
        caster: Address of the caster.
        mountpoint: Name of the stream.
        user: User name.
        password: Password.
        gga: Seconds between two positions.
        ntrip: Version of the protocol.
        persistent: As for `Corrections`.

    Raises:
        ImportError: The extra ``rtk`` is not installed.
        UsageError: An argument is not valid.
    """
    from xbus.extras import require
    from xbus.rtk import Caster, Fix

    require("pygnssutils", "rtk", "to get corrections from a caster")
    require("pyrtcm", "rtk", "to find RTCM 3 frames")
    fix = Fix()
    try:
        source = Caster(
            caster,
            mountpoint,
            user=user,
            password=password,
            gga=gga,
            position=lambda: fix.position,
            ntrip=int(ntrip),
        )
    except ValueError as error:
        raise click.UsageError(str(error)) from None
    return Corrections(source, fix, persistent=persistent)


def check_receiver(device: Device, *, with_position: bool) -> None:
    """Checks that a device in Config State accepts corrections and outputs its position if that is needed.

    Raises:
        Failure: The device does not output its position.
        StateError: The product does not accept corrections; the message lists those that do.
    """
    outputs = {output.quantity for output in device.commands.req_output_configuration()}
    if device.support is not None and "ForwardGnssData" not in device.support.messages:
        # Raises an error that names the products, and sends nothing.
        device.command("ForwardGnssData", b"")
    if with_position and not outputs & {"gnss_pvt_data", "lat_lon"}:
        raise Failure("the device outputs no position for --gga; add gnss_pvt_data to its outputs")


class Corrections:
    """Corrections from a caster, which a thread forwards to a device.

    Args:
        caster: A `xbus.rtk.Caster`.
        fix: The `xbus.rtk.Fix` that has the position for the caster.
        persistent: Whether to report errors and continue. Otherwise the first error ends the thread, and
            `read` raises it.

    Attributes:
        caster: The caster.
        fix: The fix.
        forwarder: Counts messages and bytes; None until the thread is started.
        refused: Number of corrections that the device refused.
    """

    def __init__(self, caster: Any, fix: Any, *, persistent: bool) -> None:
        self.caster, self.fix = caster, fix
        self.forwarder: Any = None
        self.refused = 0
        self._persistent = persistent
        self._error: Exception | None = None
        self._blocks: Any = None
        self._corrected_at: float | None = None
        self._stop = threading.Event()
        self._problems: SimpleQueue[str] = SimpleQueue()
        self._reported: set[str] = set()
        self._last_state, self._last_rtk = "idle", None

    @contextlib.contextmanager
    def forwarding(self, device: Device) -> Iterator[Corrections]:
        """Forwards corrections to a device for the length of a ``with`` block."""
        from xbus.rtk import Forwarder

        self.forwarder = Forwarder(device)
        thread = threading.Thread(target=self._run, args=(device,), name="xbus-rtk", daemon=True)
        thread.start()
        try:
            yield self
        finally:
            self._stop.set()
            self.caster.close()
            thread.join(JOIN_TIMEOUT)

    def _run(self, device: Device) -> None:
        while not self._stop.is_set():
            try:
                frame = self.caster.read(READ_TIMEOUT)
                # While the port is lost, a correction would be outdated before it is sent.
                if frame and (_measures(device) or not self._persistent):
                    self.forwarder.forward([frame])
                    self._corrected_at = time.monotonic()
            except XbusError as error:
                if not self._persistent:
                    self._error = error
                    return
                self._handle(error)
            except Exception as error:  # of the libraries that read from the caster
                self._error = error
                self._problems.put(f"corrections have ended: {error!r}")
                return

    def _handle(self, error: XbusError) -> None:
        """Reports an error, once, and waits if it is one of the caster."""
        from xbus.rtk import CasterError

        if isinstance(error, Disconnected | StateError):
            return  # the recording reports that the port is lost
        text = str(error)
        self.refused += isinstance(error, DeviceError)
        is_from_caster = isinstance(error, CasterError)
        if text not in self._reported:
            self._reported.add(text)
            again = f"; the next attempt follows in {REFUSED_PAUSE:.0f} s" if is_from_caster else ""
            self._problems.put(f"corrections: {text}{again}")
        if is_from_caster:
            self._stop.wait(REFUSED_PAUSE)

    def read(self, device: Device, seconds: float) -> None:
        """Waits, and updates the fix with the samples that arrive. Other readers must not read meanwhile.

        Raises:
            Disconnected: The port is gone.
            Exception: Forwarding has failed, and is not persistent.
        """
        if self._error is not None and not self._persistent:
            raise self._error
        if self._blocks is None:
            self._blocks = device.blocks(
                seconds=seconds, quantities=self.fix.QUANTITIES, timeout=SAMPLE_TIMEOUT
            )
        with contextlib.suppress(StateError, XbusTimeout):
            self.fix.update_from_block(next(self._blocks))

    @property
    def age(self) -> float | None:
        """Seconds since the last correction; None before the first."""
        return None if self._corrected_at is None else time.monotonic() - self._corrected_at

    def news(self) -> Iterator[tuple[str, bool]]:
        """Yields what has changed since the last call: a text, and whether it is a problem."""
        with contextlib.suppress(Empty):
            while True:
                yield self._problems.get_nowait(), True
        state, caster = self.caster.state, self.caster
        if state != self._last_state and state in ("streaming", "lost", "no position"):
            self._last_state = state
            if state == "streaming":
                yield f"corrections arrive from {caster.host}", False
            elif state == "lost":
                yield f"corrections: {caster.problem}; xbus connects again", True
            else:
                yield (
                    "corrections: the caster needs a position, and the device has no fix yet",
                    False,
                )
        if self.fix.rtk != self._last_rtk:
            self._last_rtk = self.fix.rtk
            yield f"RTK {self.fix.rtk}", False

    def describe_fix(self) -> str:
        """Returns the fix in words."""
        return f"fix {self.fix.type or 'unknown'}, RTK {self.fix.rtk or 'unknown'}"

    def describe_counts(self) -> str:
        """Returns what was forwarded, and the state of the caster if it does not stream."""
        forwarder, caster, age = self.forwarder, self.caster, self.age
        parts = [format_count(forwarder.messages, "message"), format_count(forwarder.bytes, "byte")]
        if age is not None:
            parts.append(f"last {age:.1f} s ago")
        if forwarder.unanswered:
            parts.append(f"{forwarder.unanswered} unanswered")
        if self.refused:
            parts.append(f"{self.refused} refused")
        if caster.gga_sent:
            parts.append(f"{caster.gga_sent} GGA")
        if caster.state != "streaming":
            parts.append(f"caster: {caster.problem or caster.state}")
        return ", ".join(parts)


def _measures(device: Device) -> bool:
    from xbus.protocol.values import State

    return device.link.acquisition.ended is None and device.state == State.MEASUREMENT
