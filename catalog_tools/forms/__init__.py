"""Forms: what the columns of a kind of table mean. Built-in ones, and column maps of the user."""

from __future__ import annotations

from .form import ColumnSource, Epoch, Form, IdRule, Layout
from .load import known_forms, load_form

__all__ = ["Epoch", "Form", "IdRule", "Layout", "ColumnSource", "known_forms", "load_form"]
