"""Studies of the product itself: accuracy, whole scenes, ledger, detection, self-test."""
