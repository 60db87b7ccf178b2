"""Studies of capacity: what sensors see of a catalogue over a period, how often, with what gaps."""
