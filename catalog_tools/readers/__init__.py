"""Readers of star tables: any kind of file, any form, to tables of the canonical columns.

The kind of a file is told from its first bytes, never from its name. Every reader yields tables of
bounded size with the schema INCOMING, the rows in the file's order; an absent value is null.
"""

from __future__ import annotations

from .detect import detect_form, told_form
from .kinds import kind_of
from .read import read_tables

__all__ = ["detect_form", "kind_of", "read_tables", "told_form"]
