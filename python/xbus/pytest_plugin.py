"""The pytest plugin: virtual devices as fixtures, for tests of any program that talks to an MTi.

pytest loads this module at every start, so it imports nothing but pytest until a fixture is used.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xbus.device.output_configuration import OutputConfiguration
    from xbus.sim.device import SimulatedDevice

__all__ = ["MakeXbusDevice", "ServedDevice", "make_xbus_device", "xbus_device"]

MARKER = "xbus_device"


@dataclass(frozen=True)
class ServedDevice:
    """A virtual device behind a port.

    Attributes:
        port: What a program opens: the path of a pseudo-terminal, or ``socket://HOST:PORT``.
        device: The virtual device. Its time is real time. Physical actions, such as `unplug`, and changes of
            `faults` are possible at any time.
    """

    port: str
    device: SimulatedDevice


class MakeXbusDevice(Protocol):
    """The type of the fixture `make_xbus_device`."""

    def __call__(
        self,
        product: str | int = "MTi-630",
        *,
        output_configuration: OutputConfiguration | None = None,
        tcp: bool = False,
        speed: float = 1.0,
        **options: Any,
    ) -> ServedDevice:
        """Serves another virtual device until the test ends.

        Args:
            product: Product name or number.
            output_configuration: Rates in Hz by quantity, such as ``{"acceleration": 100}``; None: as
                delivered.
            tcp: Whether to serve on TCP instead of a pseudo-terminal.
            speed: Seconds of device time per second.
            options: Other arguments of `xbus.SimulatedDevice`, such as ``faults`` or ``noise``.

        Raises:
            ValueError: A wrong product, output configuration or option.
        """


def pytest_configure(config: pytest.Config) -> None:
    """Registers the marker."""
    config.addinivalue_line(
        "markers",
        f"{MARKER}(product='MTi-630', *, output_configuration=None, tcp=False, speed=1.0, **options): "
        "the virtual device that the fixture xbus_device serves; options are those of "
        "xbus.SimulatedDevice",
    )


@pytest.fixture
def xbus_device(request: pytest.FixtureRequest, make_xbus_device: MakeXbusDevice) -> ServedDevice:
    """A virtual MTi on a serial port: ``xbus_device.port``. The marker ``xbus_device`` chooses it."""
    marker = request.node.get_closest_marker(MARKER)
    return make_xbus_device() if marker is None else make_xbus_device(*marker.args, **marker.kwargs)


@pytest.fixture
def make_xbus_device(tmp_path_factory: pytest.TempPathFactory) -> Iterator[MakeXbusDevice]:
    """A function that serves more virtual devices, each on a port; it takes what the marker takes."""
    with ExitStack() as stack:

        def make(
            product: str | int = "MTi-630",
            *,
            output_configuration: OutputConfiguration | None = None,
            tcp: bool = False,
            speed: float = 1.0,
            **options: Any,
        ) -> ServedDevice:
            import xbus
            from xbus.sim import serving

            faults = options.pop("faults", None)
            device = xbus.SimulatedDevice(product, **options)
            # connect returns when the device has started and measures.
            with xbus.connect(device) as host:
                if output_configuration is not None:
                    # Without a baud rate the port is like USB, which has no limit.
                    with host.configure(output_configuration, check_baudrate=device.is_serial):
                        pass
            device.faults = faults
            # The link stays when a plug is pulled and put in again; the pseudo-terminal is another one then.
            link = None if tcp else tmp_path_factory.mktemp("xbus") / "port"
            port = stack.enter_context(serving(device, tcp=tcp, link=link, speed=speed))
            return ServedDevice(port, device)

        yield make
