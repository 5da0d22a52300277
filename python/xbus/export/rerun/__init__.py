"""Recordings for the viewer rerun.

`RerunStream` sends the parts of a log, or blocks of live samples, to a recording stream of rerun: to a viewer
or, by `Rrd`, to a file.
"""
