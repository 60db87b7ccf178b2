"""API keys: made once, shown once, stored as argon2 hashes, revoked for good."""

from __future__ import annotations

import re
import secrets
import time
from functools import lru_cache
from typing import Any

import sqlalchemy as sa
from argon2 import PasswordHasher
from argon2.exceptions import Argon2Error, InvalidHashError

from catalog_tools.documents import JsonObject
from pipeline.errors import BadInput
from service.jobs.jobs import record
from service.store.database import now_s, writing
from service.store.tables import keys

TOKEN = re.compile(r"ng_([0-9a-f]{12})_([A-Za-z0-9_-]{43})")
# Of a secret that was thrown away, with the parameters of all keys.
NOBODYS = (
    "$argon2id$v=19$m=19456,t=2,p=1$5esmdPyTlwYESEsbE"
    "6fsRQ$TMj41AWY5ZRJ5urg6HKuXHNvZMd52lZSjx4ZnhpfOBU"
)
TEAM = re.compile(r"[a-z0-9][a-z0-9._-]{0,63}")


@lru_cache(maxsize=1)
def _hasher() -> PasswordHasher:
    """argon2id with 19 MiB and two passes: the secret has 256 bits, guessing is hopeless anyway."""
    return PasswordHasher(time_cost=2, memory_cost=19_456, parallelism=1)


def create_key(
    engine: sa.Engine, team: str, name: str = "", days: float | None = None, actor: str = "command"
) -> str:
    """Make a key of a team and return it; only its hash is kept. BadInput for a bad team name."""
    if not TEAM.fullmatch(team):
        raise BadInput("--team", team, "1 to 64 of a-z, 0-9, dot, dash, underscore")
    if len(name) > 128 or not name.isprintable():
        raise BadInput("--name", name, "at most 128 printable characters")
    if days is not None and not 0 < days < 36_500:
        raise BadInput("--days", days, "more than 0 and less than 36500")
    key_id, secret = secrets.token_hex(6), secrets.token_urlsafe(32)
    with writing(engine) as db:
        now = now_s(db)
        row = {"id": key_id, "team": team, "name": name, "hash": _hasher().hash(secret)}
        times = {
            "created_s": now,
            "revoked_s": None,
            "expires_s": None if days is None else now + days * 86_400,
        }
        db.execute(sa.insert(keys), [row | times])
        record(db, team, actor, "key.create", key_id, name)
    return f"ng_{key_id}_{secret}"


def revoke_key(engine: sa.Engine, key_id: str, actor: str = "command") -> None:
    """Make a key worthless from now on. BadInput where there is none of this id."""
    if match := TOKEN.fullmatch(key_id):
        key_id = match[1]
    with writing(engine) as db:
        row = db.execute(sa.select(keys).where(keys.c.id == key_id)).first()
        if row is None:
            raise BadInput("KEY", key_id, "the id of a key, as `nightglass keys list` shows it")
        if row.revoked_s is None:
            query = sa.update(keys).where(keys.c.id == key_id)
            db.execute(query.values(revoked_s=now_s(db)))
            record(db, row.team, actor, "key.revoke", key_id)


def list_keys(engine: sa.Engine) -> list[JsonObject]:
    """Every key ever made, without its hash."""
    shown = [c for c in keys.c if c.name != "hash"]
    with engine.connect() as db:
        query = sa.select(*shown).order_by(keys.c.created_s)
        return [dict(row) for row in db.execute(query).mappings()]


def any_key(engine: sa.Engine) -> bool:
    """Whether a key was ever made: from then on every request needs one."""
    with engine.connect() as db:
        return db.execute(sa.select(keys.c.id).limit(1)).first() is not None


def usable(row: Any, now: float | None = None) -> bool:
    now = time.time() if now is None else now
    return row.revoked_s is None and (row.expires_s is None or row.expires_s > now)


def find_key(engine: sa.Engine, key_id: str) -> Any:
    """The row of a key, or None."""
    with engine.connect() as db:
        return db.execute(sa.select(keys).where(keys.c.id == key_id)).first()


def matches(row: Any, secret: str) -> bool:
    """Whether a secret is the one of a key that may be used: tens of milliseconds, by design, and
    the same where there is no such key (None), so that the time tells of no id."""
    try:
        same = _hasher().verify(NOBODYS if row is None else row.hash, secret)
        return bool(same) and row is not None and usable(row)
    except (Argon2Error, InvalidHashError):
        return False
