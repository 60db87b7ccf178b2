"""Bytes at rest: files that are whole or absent, folders, URLs, object stores."""
