"""What ``xbus decode`` leaves out, and why."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from itertools import islice
from typing import TYPE_CHECKING

from xbus.cli.argument_options import with_argument_options
from xbus.cli.failure import Failure
from xbus.formatting import device_name

if TYPE_CHECKING:
    from xbus.cli.decoded_totals import DecodedTotals
    from xbus.describe.log_summary import LogSummary
    from xbus.log.log import Log
    from xbus.log.trackers import Tracker

__all__ = ["check_decoded", "tracker_of", "undecoded_lines"]

#: Maximum number of trackers that a message names.
MAX_NAMED = 32


def check_decoded(log: Log | LogSummary, names: str) -> None:
    """Checks that there is something to write.

    Raises:
        Failure: Nothing in the log was decoded.
    """
    from xbus.log.log import Log
    from xbus.protocol.undecoded import describe_undecoded

    decoded = (
        [log.keys(), log.strings.counts] if isinstance(log, Log) else [log.quantities, log.strings]
    )
    if log.undecoded and not any(decoded):
        what = with_argument_options(describe_undecoded(log.undecoded))
        raise Failure(f"{names}: nothing was decoded: {what}")


def undecoded_lines(log: Log | DecodedTotals, tracker: Tracker | None = None) -> Iterator[str]:
    """Yields what is not in the table, and why; the table is that of the log or of a tracker."""
    from xbus.protocol.undecoded import NO_ORIENTATION, describe_undecoded

    if log.undecoded:
        yield f"not decoded: {with_argument_options(describe_undecoded(log.undecoded))}"
    if log.trackers:
        yield NO_ORIENTATION
    if len(log.trackers) > 1 and tracker is None:
        names = _names(log.trackers)
        yield f"the table has one tracker of each message; --tracker writes all rows of one: {names}"


def tracker_of(log: Log, tracker: str, names: str) -> Tracker:
    """Returns an Awinda tracker.

    Args:
        log: The log.
        tracker: Its identifier in hex, as xbus info prints it.
        names: Names of the files, for error messages.

    Raises:
        Failure: The log has no such tracker.
    """
    for device_id, found in log.trackers.items():
        if f"{device_id:08X}" == tracker.upper().zfill(8):
            return found
    known = _names(log.trackers)
    hint = f"it has {known}" if known else "it has no Awinda trackers"
    raise Failure(f"no tracker {tracker} in {names}; {hint}")


def _names(trackers: Collection[int]) -> str:
    """Returns the identifiers of trackers as text; those of damaged logs can be many."""
    names = ", ".join(device_name(device_id) for device_id in islice(trackers, MAX_NAMED))
    more = len(trackers) - MAX_NAMED
    return f"{names} and {more:,} more" if more > 0 else names
