"""What a sensor can see of very many objects, without drawing: places, light, detection."""
