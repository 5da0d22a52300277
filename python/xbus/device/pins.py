"""The pins DRDY and nRST of a device, on GPIO lines of Linux."""

from __future__ import annotations

import time
from datetime import timedelta
from typing import Any

from xbus.errors import BusError
from xbus.extras import require

__all__ = ["GpioDataReady", "GpioReset"]

#: Name that other programs see as the user of a line.
CONSUMER = "xbus"
#: Seconds for which nRST is low. The data sheet gives no time.
RESET_SECONDS = 0.01


def _request(chip: str, line: str, **settings: Any) -> tuple[Any, int | str]:
    """Returns the request for a line, and the line.

    Raises:
        BusError: The line does not exist, is in use, or the user may not use it.
        ImportError: The extra is not installed.
    """
    gpiod = require("gpiod", "i2c", "to use the pins DRDY and nRST")
    key: int | str = int(line) if line.isdecimal() else line
    try:
        request = gpiod.request_lines(
            chip, consumer=CONSUMER, config={key: gpiod.LineSettings(**settings)}
        )
    except (OSError, ValueError) as error:
        number = error.errno if isinstance(error, OSError) else None
        raise BusError(
            number,
            f"the line {line} of {chip} cannot be used: {getattr(error, 'strerror', None) or error}; gpioinfo"
            " lists the lines and their users, and the group gpio may use them",
        ) from error
    return request, key


class GpioDataReady:
    """The input at DRDY.

    Args:
        chip: Path of the GPIO chip.
        line: Number or name of the line.

    Raises:
        BusError: The line cannot be used.
        ImportError: The extra ``i2c`` is not installed.
    """

    def __init__(self, chip: str, line: str) -> None:
        values = require("gpiod.line", "i2c", "to use the pin DRDY")
        self._active = values.Value.ACTIVE
        self._request, self._line = _request(
            chip, line, direction=values.Direction.INPUT, edge_detection=values.Edge.RISING
        )

    def is_active(self) -> bool:
        """Returns whether it is high."""
        return bool(self._request.get_value(self._line) == self._active)

    def wait(self, timeout: float) -> None:
        """Waits for an edge, up to ``timeout`` seconds, and removes those that were."""
        if self._request.wait_edge_events(timedelta(seconds=timeout)):
            self._request.read_edge_events()

    def close(self) -> None:
        """Releases the line."""
        self._request.release()


class GpioReset:
    """The output at nRST, which is only pulled low: the device has a pull-up.

    Args:
        chip: Path of the GPIO chip.
        line: Number or name of the line.

    Raises:
        BusError: The line cannot be used.
        ImportError: The extra ``i2c`` is not installed.
    """

    def __init__(self, chip: str, line: str) -> None:
        values = require("gpiod.line", "i2c", "to use the pin nRST")
        self._values = values.Value
        self._request, self._line = _request(
            chip,
            line,
            direction=values.Direction.OUTPUT,
            drive=values.Drive.OPEN_DRAIN,
            output_value=values.Value.ACTIVE,
        )

    def pulse(self) -> None:
        """Pulls it low for 10 ms."""
        self._request.set_value(self._line, self._values.INACTIVE)
        time.sleep(RESET_SECONDS)
        self._request.set_value(self._line, self._values.ACTIVE)

    def close(self) -> None:
        """Releases the line."""
        self._request.release()
