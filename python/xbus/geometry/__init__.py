"""The Earth and rotations: what virtual devices, reports and the monitor compute with."""
