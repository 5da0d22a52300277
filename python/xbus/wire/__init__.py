"""Frames, messages, packets and strings: the bytes on the wire, one at a time."""
