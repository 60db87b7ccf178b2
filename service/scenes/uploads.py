"""Files that clients upload for their scenes: named by their content, seen by their team alone."""

from __future__ import annotations

import asyncio
import hashlib
import os
import re
import time
import uuid
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

import numpy as np
import sqlalchemy as sa
from numpy.lib import format as npy
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request

from catalog_tools.documents import JsonObject
from pipeline.errors import NO_ROOM
from pipeline.spec.load import path_holders
from service.accounts.auth import Caller
from service.http.bodies import discard_rest
from service.jobs.jobs import record
from service.jobs.quotas import used_by
from service.problems import (
    Malformed,
    NotAllowed,
    NotThere,
    QueueFull,
    StoreFull,
    TooLarge,
    TooSlow,
)
from service.settings import Settings
from service.store.database import writing
from service.store.named_files import PREFIX, check_unused
from service.store.tables import uploads

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
KINDS = (
    "npy",
    "fits",
    "fit",
    "csv",
    "txt",
    "dat",
    "int",
    "ecsv",
    "obj",
    "stl",
    "ply",
    "glb",
    "json",
    "xml",
    "kvn",
    "oem",
    "omm",
    "tle",
    "parquet",
)
PACKED = (b"\x1f\x8b", b"PK\x03\x04", b"BZh", b"\xfd7zXZ", b"\x28\xb5\x2f\xfd")
HEADER_BYTES = 4096
PART = ".part-"  # begins the name of a file that is still coming


class Uploads:
    """The folder of uploaded files, and the table that says whose they are."""

    def __init__(self, settings: Settings, engine: sa.Engine) -> None:
        self._settings, self._engine = settings, engine

    def remove_cut_off(self) -> None:
        """Remove what an earlier process had of files that no longer come."""
        for part in self._settings.uploads.glob(f"{PART}*"):
            with suppress(FileNotFoundError):  # another service on this folder was first
                if part.stat().st_mtime < time.time() - self._settings.upload_s:
                    part.unlink()

    async def receive(self, request: Request, name: str, caller: Caller) -> JsonObject:
        """Store a request's body under the digest of its content. Memory stays a piece's size.

        NotAllowed for a name, kind or content that is not taken; TooLarge, TooSlow, QueueFull,
        StoreFull.
        """
        kind = name.rpartition(".")[2].lower()
        if not NAME.fullmatch(name) or kind not in KINDS:
            allowed = f"letters, digits, . _ -, ending in .{', .'.join(KINDS)}"
            raise NotAllowed(f"?name: allowed: {allowed}", (("?name", name, allowed),))
        await run_in_threadpool(self._check_room, caller.team)
        part = self._settings.uploads / f"{PART}{uuid.uuid4().hex}"
        try:
            digest, size = await self._store(request, part)
            await run_in_threadpool(check_content, part, kind)
            file_id = f"{digest[:32]}.{kind}"
            row = {"team": caller.team, "id": file_id, "name": name, "bytes": size}
            await run_in_threadpool(self._keep, part, row, caller)
        except OSError as error:
            if error.errno not in NO_ROOM:
                raise
            raise StoreFull("the disk of the uploads is full: the file was not stored") from error
        finally:
            part.unlink(missing_ok=True)
        return {"id": PREFIX + file_id, "name": name, "bytes": size, "sha256": digest}

    async def _store(self, request: Request, part: Path) -> tuple[str, int]:
        most, digest, size = self._settings.upload_bytes, hashlib.sha256(), 0
        declared = request.headers.get("content-length", "")
        too_large = declared.isdigit() and (len(declared) > 18 or int(declared) > most)
        try:
            async with asyncio.timeout(self._settings.upload_s):
                with part.open("wb") as out:
                    stream = request.stream()
                    while not too_large and (piece := await anext(stream, None)) is not None:
                        size += len(piece)
                        too_large = size > most
                        digest.update(piece)
                        await run_in_threadpool(out.write, piece)
                    out.flush()
                    await run_in_threadpool(os.fsync, out.fileno())
        except TimeoutError:
            raise TooSlow(f"a file must arrive within {self._settings.upload_s:g} s") from None
        except ClientDisconnect:
            raise Malformed("the file ended before it was whole") from None
        if too_large:
            await discard_rest(request)
            raise TooLarge(f"a file of at most {most} bytes is taken")
        return digest.hexdigest(), size

    def _check_room(self, team: str) -> None:
        with self._engine.connect() as db:
            self._refuse_full(db, team)

    def _refuse_full(self, db: sa.Connection, team: str) -> None:
        most = self._settings.bytes_kept
        if used_by(db, team, 0).bytes_kept >= most:
            raise QueueFull(f"a team may keep {most} bytes; delete some jobs or files first")

    def _keep(self, part: Path, row: JsonObject, caller: Caller) -> None:
        with writing(self._engine) as db:
            mine = (uploads.c.team == row["team"], uploads.c.id == row["id"])
            new = db.execute(sa.select(uploads.c.id).where(*mine)).first() is None
            if new:  # others may have come since this one began
                self._refuse_full(db, row["team"])
            part.replace(self._settings.uploads / row["id"])
            if new:
                db.execute(sa.insert(uploads), [row | {"created_s": time.time()}])
                record(db, caller.team, caller.actor, "upload", row["id"], row["name"])

    def listing(self, team: str) -> list[JsonObject]:
        """A team's files, oldest first."""
        query = sa.select(uploads).where(uploads.c.team == team).order_by(uploads.c.created_s)
        with self._engine.connect() as db:
            return [
                {"id": PREFIX + row.id, "name": row.name, "bytes": row.bytes}
                for row in db.execute(query)
            ]

    def names(self, team: str, ids: Iterable[str]) -> dict[str, str]:
        """The name by which a team sent each file of these ids."""
        return names_of(self._engine, team, ids)

    def has(self, team: str, file_id: str) -> bool:
        """Whether a team has a file of this id (without `upload:`)."""
        query = sa.select(uploads.c.id).where(uploads.c.team == team, uploads.c.id == file_id)
        with self._engine.connect() as db:
            return db.execute(query).first() is not None

    def remove(self, caller: Caller, file_id: str) -> None:
        """Forget a team's file; the bytes go when no other team has them. NotThere, and NotReady
        while a job that has not ended names it."""
        if "\0" in file_id:  # PostgreSQL takes none
            raise NotThere("there is no such file")
        with writing(self._engine) as db:
            check_unused(db, caller.team, file_id)
            mine = (uploads.c.team == caller.team, uploads.c.id == file_id)
            if db.execute(sa.delete(uploads).where(*mine)).rowcount == 0:
                raise NotThere("there is no such file")
            record(db, caller.team, caller.actor, "upload.delete", file_id)
            if db.execute(sa.select(uploads.c.id).where(uploads.c.id == file_id)).first() is None:
                (self._settings.uploads / file_id).unlink(missing_ok=True)


def names_of(engine: sa.Engine, team: str, ids: Iterable[str]) -> dict[str, str]:
    """The name by which a team sent each file of these ids."""
    wanted = list(ids)
    if not wanted:
        return {}
    query = sa.select(uploads.c.id, uploads.c.name)
    with engine.connect() as db:
        found = db.execute(query.where(uploads.c.team == team, uploads.c.id.in_(wanted)))
        return {row.id: row.name for row in found}


def bytes_kept(engine: sa.Engine, team: str) -> int:
    """Bytes on disk of a team's products and files."""
    with engine.connect() as db:
        return used_by(db, team, 0).bytes_kept


def check_content(path: Path, kind: str) -> None:
    """Refuse what is packed, and images whose header tells of more than the file holds."""
    with path.open("rb") as file:
        head = file.read(HEADER_BYTES)
    if head.startswith(PACKED):
        _refuse("a packed file", "the file itself, not compressed")
    if kind == "npy":
        _check_npy(path)
    if kind in ("fits", "fit"):
        _check_fits(path, head)


def _check_npy(path: Path) -> None:
    """The header is read as text, never run; nothing of the values is."""
    try:
        with path.open("rb") as file:
            version = npy.read_magic(file)
            read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
            shape, _, dtype = read(file, max_header_size=HEADER_BYTES)
            start = file.tell()
    except Exception:  # whatever numpy's reader of literals, tokens and types comes upon
        _refuse("no NPY header", "a .npy file as numpy.save writes it")
    if not isinstance(dtype, np.dtype) or dtype.hasobject or dtype.kind not in "fiu":
        _refuse(str(dtype), "numbers; Python objects (pickles) are never read")
    told, size = dtype.itemsize, path.stat().st_size - start
    for length in shape:
        told *= length
    if told != size or min(shape, default=0) < 0:
        _refuse(f"a header of {told} bytes of values", f"as many as the file holds ({size})")


def _check_fits(path: Path, head: bytes) -> None:
    if not head.startswith(b"SIMPLE  ="):
        _refuse("no FITS header", "a FITS file")
    with path.open("rb") as file:
        before = b""
        while piece := file.read(1 << 20):
            if b"ZIMAGE  =" in before + piece:
                _refuse("a compressed FITS image", "an image that is not compressed")
            before = piece[-16:]


def _refuse(value: str, allowed: str) -> None:
    raise NotAllowed(f"the file: allowed: {allowed}", (("", value, allowed),))


def engine_scene(scene: JsonObject, settings: Settings) -> JsonObject:
    """A scene as the engine gets it: `upload:ID` becomes the file's place beside the catalogues,
    where the engine runs; no absolute path of the server enters a product."""
    folder = os.path.relpath(settings.uploads, settings.catalogues.resolve())
    for _, holder, key in path_holders(scene):
        value = holder.get(key)
        if isinstance(value, str) and value.startswith(PREFIX):
            holder[key] = f"{folder}/{value.removeprefix(PREFIX)}"
    return scene
