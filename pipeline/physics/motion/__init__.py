"""How the sensor points and how light moves over the focal plane."""
