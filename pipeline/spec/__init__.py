"""What is asked for: the scene file as frozen, strictly checked models."""
