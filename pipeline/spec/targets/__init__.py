"""Targets as asked for: bodies, meshes, orbits, populations."""
