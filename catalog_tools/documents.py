"""JSON documents as plain values: files, requests and reports before a model reads them."""

from __future__ import annotations

from typing import Any

JsonObject = dict[str, Any]  # values: text, numbers, true, false, None, lists, and objects
Arguments = dict[str, Any]  # by name, of a constructor or a function
