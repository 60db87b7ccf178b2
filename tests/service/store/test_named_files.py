"""Files that jobs name: what is said of those that hold one."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import sqlalchemy as sa

from service.problems import NotReady
from service.scenes.uploads import names_of
from service.store.database import connect, sqlite_url, writing
from service.store.named_files import MOST_NAMED, check_unused
from service.store.tables import uploads

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


def test_a_file_is_known_to_each_team_by_its_own_name(tmp_path: Path) -> None:
    """Two teams sent the same bytes, one alone some others."""
    engine = connect(sqlite_url(tmp_path / "jobs.sqlite"))
    sent = [("red", "a.csv", "first.csv"), ("blue", "a.csv", "second.csv"),
            ("red", "b.csv", "third.csv")]  # fmt: skip
    with writing(engine) as db:
        for team, number, name in sent:
            row = {"team": team, "id": number, "name": name, "bytes": 1, "created_s": 0.0}
            db.execute(sa.insert(uploads), [row])
    ids = ["a.csv", "b.csv", "c.csv"]
    assert names_of(engine, "red", ids) == {"a.csv": "first.csv", "b.csv": "third.csv"}
    assert names_of(engine, "blue", ids) == {"a.csv": "second.csv"}
    assert names_of(engine, "green", ids) == {}
    engine.dispose()
