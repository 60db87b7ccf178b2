"""Meshes: facets with glossy surfaces, moving parts, shadows; intensity and pictures."""
