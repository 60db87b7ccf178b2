"""Accuracy: error against CPU time of our drawing engines and of other simulators, in one run."""
