"""Read a catalogue: the stars in a region, the light of stars not drawn."""
