"""Recordings in the formats of other software.

A `Format` is what to write: a format with its options. `export` writes a log, or its parts in order, to a
file: `Log.to_gpx` and ``xbus decode -o walk.gpx`` call it. Each module beside `format` has one format or a
family of formats.
"""
