"""Verify a whole catalogue: every byte, every row, every count."""
