"""Plots of quantities over time: which curves there are, how they are thinned, and drawing them."""
