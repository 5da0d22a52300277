"""The result of one check."""

from __future__ import annotations

from typing import Literal, NamedTuple, TypeAlias

__all__ = ["Finding", "Verdict", "worst"]

Verdict: TypeAlias = Literal["ok", "warning", "problem"]
#: From the best to the worst.
ORDER: tuple[Verdict, ...] = ("ok", "warning", "problem")


class Finding(NamedTuple):
    """The result of one check.

    Attributes:
        check: Name of the check: ``"extension"``, ``"libraries"``, ``"ports"``, ...
        verdict: ``"ok"``; ``"warning"`` for what may cause trouble; ``"problem"`` for what does not work.
        message: What was found.
        remedy: What to do about it, usually a command; None for "ok".
    """

    check: str
    verdict: Verdict
    message: str
    remedy: str | None = None


def worst(findings: list[Finding]) -> Verdict:
    """Returns the worst verdict; "ok" if there is no finding."""
    return max((finding.verdict for finding in findings), key=ORDER.index, default="ok")
