"""Products in the formats that others read: FITS, pictures, movies, labels and masks."""
