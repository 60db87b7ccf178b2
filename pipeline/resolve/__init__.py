"""A scene resolved once: every file read, every default filled, its stars counted."""
