"""Who is calling: keys, tokens, tickets, teams."""
