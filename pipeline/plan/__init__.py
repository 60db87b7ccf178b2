"""What a scene needs: facts, decisions with their bounds, tiles and cost."""
