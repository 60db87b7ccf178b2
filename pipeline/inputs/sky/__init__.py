"""What the sky's light is made from."""
