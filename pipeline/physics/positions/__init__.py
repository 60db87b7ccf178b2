"""Where things are: time scales, the Earth, orbits, apparent places, the focal plane."""
