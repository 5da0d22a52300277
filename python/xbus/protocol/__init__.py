"""The protocol as values: messages, settings and products."""

from xbus.protocol import values
from xbus.protocol.messages import decode, encode
from xbus.protocol.values import *  # noqa: F403 - the names are listed there

__all__ = ["decode", "encode"]
__all__ += values.__all__
