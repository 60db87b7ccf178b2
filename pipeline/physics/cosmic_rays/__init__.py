"""Cosmic rays: tracks through silicon, libraries of recorded events, and how to find those."""
