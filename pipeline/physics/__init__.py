"""Physics as pure functions on arrays; packages do not know each other."""

from pathlib import Path

from pipeline.compiled import forget_stale, keep_apart, keep_somewhere

forget_stale(Path(__file__).parent)
keep_apart(Path(__file__).parent)
keep_somewhere(Path(__file__).parent)
