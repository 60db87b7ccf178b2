"""Decisions about targets: what lights, hides and moves them, and which are in the field."""
