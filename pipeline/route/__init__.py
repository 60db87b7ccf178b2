"""The route of a scene to its product: prepare, render, resume, join, finish."""
