"""What a scene's sensor sees of its targets, and how well, without drawing."""
