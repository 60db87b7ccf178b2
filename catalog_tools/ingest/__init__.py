"""Make a catalogue from files of stars; every file and every row accounted for."""
