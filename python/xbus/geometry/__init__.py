"""The Earth and rotations, for virtual devices, reports and the monitor."""
