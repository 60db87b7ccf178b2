"""Error against run time of whole scenes: a ladder of accuracies, against the reference path."""
