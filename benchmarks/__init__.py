"""Benchmarks: figures measured in one run, never asserted on in tests."""
