"""Prove a catalogue whole: every byte, every row, every count."""
