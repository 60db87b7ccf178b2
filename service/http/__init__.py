"""Requests before any route: the gate, bodies, connections."""
