"""RTK corrections from a caster: the options of commands."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

import click

from xbus.cli.failure import Failure

if TYPE_CHECKING:
    from xbus.device import Device
    from xbus.watch.corrections import Corrections

__all__ = ["caster_options", "check_receiver", "new_corrections"]

T = TypeVar("T")


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
    from xbus.watch.corrections import Corrections

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
