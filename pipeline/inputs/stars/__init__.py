"""Stars from catalogues: opened, covered, read."""
