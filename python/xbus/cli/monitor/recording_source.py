"""A device that is being recorded, as a source of the monitor."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xbus.cli.inputs import label
from xbus.watch.device_source import DeviceSource
from xbus.watch.model import Model, RecordingState

if TYPE_CHECKING:
    from xbus.cli.recording_job import RecordingJob

__all__ = ["RecordingSource"]


class RecordingSource(DeviceSource):
    """The device of a `RecordingJob`.

    Args:
        job: The recording.
    """

    def __init__(self, job: RecordingJob) -> None:
        super().__init__(job.device, reconnect=job.reconnect, restore=True)
        self._job = job

    def model(self) -> Model:
        """Returns the model before the first block."""
        model = super().model()
        if self._job.corrections is not None:
            # The caster receives the position that the screen shows.
            model.fix = self._job.corrections.fix
        self._update_recording(model)
        return model

    def advance(self, model: Model) -> None:
        """Waits for the next block, adds it to the model, and checks the recording.

        Raises:
            Failure: The recording ended early, or the device sends nothing.
        """
        super().advance(model)
        self._job.check(lambda text, is_bad: model.add_event(text, is_bad=is_bad))
        self._update_recording(model)

    def _update_recording(self, model: Model) -> None:
        recording, corrections = self._job.recording, self._job.corrections
        model.recording = RecordingState(recording.files[-1], recording.bytes)
        if corrections is not None and corrections.forwarder is not None:
            model.corrections = corrections.describe_counts()

    def toggle_recording(self, model: Model) -> None:
        """Says how the recording ends: it is the purpose of the command."""
        file = label(self._job.recording.files[-1])
        model.add_event(f"recording to {file} until q", is_bad=False)
