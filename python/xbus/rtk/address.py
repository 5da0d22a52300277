"""The address of an NTRIP caster, and checks of what a request may contain."""

from __future__ import annotations

from typing import NamedTuple
from urllib.parse import urlsplit

__all__ = ["Address", "check_texts", "parse_address"]

HTTP_PORT, HTTPS_PORT = 2101, 443


class Address(NamedTuple):
    """Host, port, and whether the connection uses TLS."""

    host: str
    port: int
    https: bool

    def __str__(self) -> str:
        return f"{self.host}:{self.port}"


def parse_address(url: str) -> Address:
    """Returns the address in ``HOST``, ``HOST:PORT``, or either with ``http://`` or ``https://`` before it.

    The default port is 2101, and 443 for https.

    Raises:
        ValueError: The text is not an address of a caster.

    >>> str(parse_address("rtk2go.com"))
    'rtk2go.com:2101'
    """
    check_texts(caster=url)
    if "@" in url:  # the text is not quoted: it may have a password
        raise ValueError(
            "the address of a caster has no user name; write HOST or HOST:PORT, and give user name and "
            "password separately"
        )
    parts = urlsplit(url if "://" in url else f"http://{url}")
    try:
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port = None, None
    if parts.scheme not in ("http", "https") or not host or parts.path not in ("", "/"):
        raise ValueError(
            f"{url!r} is not the address of a caster; write HOST, HOST:PORT or https://HOST:PORT"
        )
    https = parts.scheme == "https"
    return Address(host, port or (HTTPS_PORT if https else HTTP_PORT), https)


def check_texts(**texts: str | None) -> None:
    """Rejects line breaks and other control characters, which would add lines to a request.

    Args:
        texts: What goes into a request, by name.

    Raises:
        ValueError: A text has a control character; a mountpoint also may not have spaces.
    """
    for name, text in texts.items():
        if text is not None and not text.isprintable():
            raise ValueError(f"{name} has a line break or another control character; remove it")
        if name == "mountpoint" and text is not None and " " in text:
            raise ValueError(f"{text!r} is not a mountpoint: it has a space")
