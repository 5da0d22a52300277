"""Libraries that are used where they are installed."""

from __future__ import annotations

import importlib
from typing import Any

__all__ = ["require"]


def require(module: str, extra: str, purpose: str) -> Any:
    """The module, imported now; if it is missing, one sentence that says how to get it.

    Raises:
        ImportError: The extra is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ImportError(
            f'{purpose}, {module} is needed: pip install "xbus-mti[{extra}]"'
        ) from error
