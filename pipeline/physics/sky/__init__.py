"""The diffuse sky: zodiacal light, the Galaxy's, undrawn stars', and the grid they are laid on."""
