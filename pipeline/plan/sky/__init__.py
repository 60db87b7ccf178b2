"""The sky of a scene: its parts on a grid, the air, stray light, and skies not drawn."""
