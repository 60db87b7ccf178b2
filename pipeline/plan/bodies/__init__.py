"""Bodies and their orbits: where they are seen, and the light they send."""
