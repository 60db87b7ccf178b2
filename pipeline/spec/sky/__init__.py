"""The sky as asked for: backgrounds, stray light, the air."""
