"""Products over HTTP: files, frames, archives."""
