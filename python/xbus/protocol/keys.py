"""How a quantity is named."""

from __future__ import annotations

__all__ = ["Key"]

#: A quantity by its name, or by name and coordinate system: ``("quaternion", "NED")``.
Key = str | tuple[str, str]
