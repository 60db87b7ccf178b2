"""Sweeps: many scenes that differ in some fields, each point paying only for what differs."""
