"""The bits of status words by name."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from xbus.log.arrays import identical, read_only
from xbus.protocol.tables import Quantity

__all__ = ["Flags"]


class Flags(Mapping[str, npt.NDArray[Any]]):
    """The bits of ``status_word`` or ``status_byte`` by name (Table 27): ``flags["filter_valid"]``.

    Each value is a read-only array ``(N,)``, computed on access: bool, or uint8 for a field of several bits.
    Two are equal if they are of the same words.
    """

    def __init__(self, words: npt.NDArray[Any], row: Quantity) -> None:
        self._words = words
        self._flags = {flag.name: flag for flag in row.flags}

    def __getitem__(self, name: str) -> npt.NDArray[Any]:
        flag = self._flags[name]
        return read_only(flag.of(self._words).astype(bool if flag.width == 1 else np.uint8))

    def __iter__(self) -> Iterator[str]:
        return iter(self._flags)

    def __len__(self) -> int:
        return len(self._flags)

    def __eq__(self, other: object) -> bool:
        return identical(self._words, other._words) if isinstance(other, Flags) else NotImplemented

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        counts = ", ".join(f"{name}: {np.count_nonzero(self[name])}" for name in self)
        return f"<Flags of {len(self._words)} words; set in: {counts}>"
