"""Virtual devices: an MTi that is made of numbers, for work away from the hardware."""
