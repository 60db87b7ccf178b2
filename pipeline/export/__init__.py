"""Products in the formats that others read: FITS and pictures."""
