"""Decisions about the detector: what it adds, and its rolling shutter."""
