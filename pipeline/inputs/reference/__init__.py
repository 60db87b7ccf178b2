"""Small published tables as typed-in figures, each with its source."""
