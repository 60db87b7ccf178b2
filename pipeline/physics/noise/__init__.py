"""Noise: streams keyed by pixel, and the chain from electrons to digital numbers."""
