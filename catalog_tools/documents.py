"""JSON documents as plain values: files, requests and reports before a model reads them."""

from __future__ import annotations

from typing import Any

JsonValue = Any  # text, a number, true, false, None, a list or an object
JsonObject = dict[str, JsonValue]
Arguments = dict[str, Any]  # by name, of a constructor or a function
