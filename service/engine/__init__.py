"""The engine's processes: led, started, watched, ended."""
