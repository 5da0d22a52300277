"""Filter profiles: the command that selects one, and its name.

The 600-series has names, joined by ``/``; the other series have numbers, to which the tables give names.
"""

from __future__ import annotations

from xbus.protocol.products import Support

__all__ = ["filter_profile_command", "filter_profile_label"]


def filter_profile_command(profile: int | str, support: Support | None) -> tuple[str, int | str]:
    """Returns the message that selects a filter profile, and its value.

    Args:
        profile: Number or name, the name in any case.
        support: The product, or None if it is not known: then the type of `profile` decides.

    Raises:
        ValueError: The product has no profile of this name.

    >>> from xbus.protocol.products import support
    >>> filter_profile_command("Dynamic", support("MTi-30"))
    ('SetFilterProfile', 41)
    """
    if support is not None and _has_names(support):
        return "SetFilterProfileModern", str(profile)
    if not isinstance(profile, str):
        return "SetFilterProfile", profile
    if support is None:
        return "SetFilterProfileModern", profile
    numbers = {known.label.lower(): known.type for known in support.filter_profiles}
    if profile.lower() not in numbers:
        product, labels = support.product.name, ", ".join(numbers)
        raise ValueError(f"the {product} has no filter profile {profile!r}; it has {labels}")
    return "SetFilterProfile", numbers[profile.lower()]


def filter_profile_label(profile: int | str, support: Support | None) -> int | str:
    """Returns the name of a filter profile as the product writes it, or `profile` if it has no name."""
    if support is not None and not _has_names(support):
        for known in support.filter_profiles:
            if profile == known.type or str(profile).lower() == known.label.lower():
                return known.label
    return profile


def _has_names(support: Support) -> bool:
    return "SetFilterProfileModern" in support.messages
