"""Who looks where, and when: observers, pointings, attitudes, dwells."""
