"""The states of a virtual device."""

from __future__ import annotations

from xbus.protocol.ids import MessageId
from xbus.protocol.values import OptionFlag, State
from xbus.sim.board import Board
from xbus.sim.measurement import Measurement

__all__ = ["Unit"]


class Unit(Board):
    """A device without its line: a board that is in one of the states. Call `power_up` first.

    Attributes:
        state: The current state.
        measurement: The current measurement; None outside Measurement.
    """

    state: State
    measurement: Measurement | None = None

    def power_up(self) -> None:
        """Starts with the stored settings."""
        if self.measurement is not None:
            self.measurement.end()
        self.state, self.measurement = State.WAKEUP, None
        super().power_up()

    def leave_wake_up(self) -> None:
        """Leaves the WakeUp State if the host has not done so."""
        if self.state is not State.WAKEUP:
            return
        flags = self.settings.option_flags
        if flags & OptionFlag.DISABLE_AUTO_MEASUREMENT:
            self.go_to_config()
            return
        is_enabled = flags & OptionFlag.ENABLE_CONFIG_MESSAGE_AT_STARTUP
        if not self.is_in_legacy_mode and (is_enabled or self.product.series != "1-series"):
            self.send_message(MessageId.Configuration, self.configuration())
            self.send_message(MessageId.EmtsData, self.emts)
        self.go_to_measurement()

    def go_to_config(self) -> None:
        """Enters Config, or remains in Config."""
        if self.measurement is not None:
            self.measurement.end()
        self.state, self.measurement = State.CONFIG, None

    def go_to_measurement(self) -> None:
        """Enters Measurement."""
        self.state, self.measurement = State.MEASUREMENT, Measurement(self)
        if self.is_in_legacy_mode:
            # After the acknowledgement, and before the data.
            self.clock.at(self.clock.now, self._send_configuration)

    def _send_configuration(self) -> None:
        self.send_message(MessageId.Configuration, self.configuration())

    def receiver_changed(self) -> None:
        """Handles a change of the fix or its RTK status."""
        super().receiver_changed()
        if self.measurement is not None:
            self.measurement.sensors_changed()
