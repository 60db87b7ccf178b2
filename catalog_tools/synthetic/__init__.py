"""Synthetic skies like Gaia DR2's: as catalogues, and as files in the archive's layout."""
