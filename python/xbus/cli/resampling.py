"""``xbus decode --rate-out``: a log at a constant rate."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from xbus.cli.failure import Failure

if TYPE_CHECKING:
    from xbus.log.log import Log
    from xbus.log.resample import Resampled
    from xbus.protocol.keys import EntryKey

__all__ = ["check_resampling", "resampled"]


def check_resampling(keys: Sequence[EntryKey], rate: float | None, max_gap: float | None) -> None:
    """Checks the options, before the log is read.

    Raises:
        click.UsageError: They do not fit together, or the quantity has no values between samples.
    """
    if rate is None:
        if max_gap is not None:
            raise click.UsageError("--max-gap needs --rate-out")
        return
    from xbus.protocol.tables import COLUMN_QUANTITIES

    for key in keys:
        name = key if isinstance(key, str) else key[0]
        if (row := COLUMN_QUANTITIES.get(name)) is None:
            raise click.UsageError(
                f"--rate-out: {name} is a string, which has no values between two"
            )
        if row.interpolation is None and row.name != "utc_time":
            raise click.UsageError(
                f"--rate-out: {name} has no values between samples; omit one of the two options"
            )


def resampled(
    log: Log, keys: Sequence[EntryKey], rate: float, max_gap: float | None, names: str
) -> Resampled:
    """Returns a log, or some of its quantities, at a constant rate.

    Args:
        log: The log.
        keys: The quantities; none for all.
        rate: Rows per second.
        max_gap: As for `Log.resample`.
        names: Names of the files, for error messages.

    Raises:
        Failure: The log cannot be resampled.
    """
    import numpy as np

    if not np.isfinite(log.time).any():
        raise Failure(
            f"{names} has no time stamps; --rate HZ derives them from the packet counter, without --rate-out "
            "the samples are written as they are"
        )
    try:
        return log.resample(rate, list(keys) or None, max_gap=max_gap)
    except ValueError as error:
        raise Failure(f"{names}: {error}") from error
