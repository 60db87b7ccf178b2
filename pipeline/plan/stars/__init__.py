"""Decisions about stars: which are drawn, by which engine, and which frames share them."""
