"""How sources are drawn: cores, wings, streaks, and the zones they are shared over."""
