"""Optional libraries, imported when they are first used."""

from __future__ import annotations

import importlib
from typing import Any

__all__ = ["require"]


def require(module: str, extra: str, purpose: str) -> Any:
    """Imports and returns a module of an extra.

    Args:
        module: Name of the module.
        extra: Name of the extra that installs it.
        purpose: What needs it, for the error message: ``"to write Parquet"``.

    Raises:
        ImportError: The extra is not installed; the message has the command that installs it.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ImportError(
            f'{purpose}, {module} is needed: pip install "xbus-mti[{extra}]"'
        ) from error
