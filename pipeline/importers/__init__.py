"""Scene files of other simulators, read as Nightglass scenes with a list of what was lost."""
