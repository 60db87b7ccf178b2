"""Fetch Gaia's public files, or cones of it by TAP: the only code that goes to the network."""
