"""The sensor's band: spectral curves, and the fit of colours to it."""
