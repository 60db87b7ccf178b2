"""What a product says drew it."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

import pytest

from catalog_tools.engine import code


def test_an_installation_tells_its_version() -> None:
    assert code.own_version() == version("nightglass")


def test_source_that_is_not_installed_is_told_by_its_digest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A render of it ended in a fault after all was drawn."""
    digest = code.code_digest()

    def none(name: str) -> str:
        raise PackageNotFoundError(name)

    monkeypatch.setattr(code, "version", none)
    assert code.own_version() == f"source {digest}"
