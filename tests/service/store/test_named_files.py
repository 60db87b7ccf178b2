"""Files that jobs name: what is said of those that hold one."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any

import pytest

from service.problems import NotReady
from service.store.named_files import MOST_NAMED, check_unused

FILE = f"{'a' * 32}.npy"


@pytest.mark.parametrize(
    ("count", "end"),
    [(1, "file: j0"), (MOST_NAMED, f"j{MOST_NAMED - 1}"), (MOST_NAMED + 3, "and 3 more")],
)
def test_a_file_that_many_jobs_name_is_kept_and_the_first_of_them_are_named(
    count: int, end: str
) -> None:
    held, other = ({"sensor": {"flat": f"upload:{name}"}} for name in (FILE, "b" + FILE[1:]))
    rows = [SimpleNamespace(id=f"j{i}", scene=json.dumps(held)) for i in range(count)]
    rows.append(SimpleNamespace(id="other", scene=json.dumps(other)))
    db: Any = SimpleNamespace(execute=lambda _: rows)
    with pytest.raises(NotReady) as refused:
        check_unused(db, "red", FILE)
    assert str(refused.value).endswith(end)
    assert str(refused.value).count(", j") == min(count, MOST_NAMED) - 1
