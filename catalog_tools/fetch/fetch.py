"""Fetch a Gaia release, whole or in cones, into a folder that ingest takes as it is."""

from __future__ import annotations

import errno
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from ..coverage import Coverage, all_sky
from ..errors import BadInput, Incomplete
from .cones import FetchCone, parse_cone
from .download import Progress, download
from .fetched import note_coverage
from .layout import Entry, Release, choose, files_coverage, parse_md5sum, release_named
from .ledger import FileLedger, file_md5, folder_for, write_whole
from .patience import FinalFailure, Patience, Unavailable
from .remote import Remote, open_remote, read_whole
from .tap import cone_coverage, fetch_cone, file_name
from .tap_service import TapService
from .transfer import size_of

ARCHIVE = "archive"  # as tap_url: the release's own TAP service
MD5SUM_NAME = "MD5SUM.txt"
MD5SUM_BYTES = 256 << 20
MOST_CONNECTIONS = 32
FIRST_TRIES = 3


@dataclass(frozen=True)
class FetchReport:
    """What a fetch brought. files : the names asked for, all of them verified in the folder."""

    release: str
    folder: str
    files: tuple[str, ...]
    downloaded: int
    bytes_downloaded: int
    present: int
    bytes_present: int
    notes: tuple[str, ...]


def silent(stage: str, done: int, total: int) -> None:
    """Tell nobody about progress."""


def fetch(
    release: str,
    destination: str | Path,
    *,
    cones: Sequence[FetchCone | str] = (),
    everything: bool = False,
    base_url: str | None = None,
    tap_url: str | None = None,
    faintest_g_mag: float | None = None,
    connections: int = 4,
    progress: Progress | None = None,
    verify: bool = False,
    patience: Patience | None = None,
) -> FetchReport:
    """Bring files of a release to `destination`; what is verified there is not brought again.

    release : `gaia-dr2` or `gaia-dr3`. cones : FetchCone, or RA,DEC,RADIUS[,G]; without
    `tap_url` the archive's files that may hold their sources, see `layout.choose` for what that may
    miss.
    everything : all files. base_url : a mirror of the archive's folder (http, https, file).
    tap_url : ask this TAP service (`archive`: the release's own) for just the rows of the cones,
    to `faintest_g_mag` where a cone has no limit itself. progress : called with ("verify" |
    "download", bytes, bytes of all) or ("query", rows, rows of the cone). verify : hash again what
    was verified before. Raises BadInput; Damaged for a file whose checksum stays wrong;
    Incomplete where the same call goes on later.
    """
    found, tell = release_named(release), progress or silent
    wanted = _cones(cones, everything, faintest_g_mag, tap_url)
    if not 1 <= connections <= MOST_CONNECTIONS:
        raise BadInput("connections", connections, f"1 to {MOST_CONNECTIONS}")
    patience = patience or Patience()
    if tap_url is not None:
        with _disk(destination), folder_for(Path(destination), found) as ledger:
            return _by_tap(found, tap_url, wanted, ledger, patience, tell, verify)
    remote = open_remote(base_url or found.base_url, patience)
    with _disk(destination), folder_for(Path(destination), found) as ledger:
        listed = _listed(remote, found, ledger, patience)
        entries = listed if everything else choose(listed, wanted)
        if not entries:
            allowed = f"a part of the sky of which {remote.address('')} lists files"
            raise BadInput("cone", [str(cone) for cone in wanted], allowed)
        tally = download(
            remote,
            entries,
            ledger,
            connections=connections,
            patience=patience,
            progress=tell,
            verify=verify,
        )
        names = [entry.name for entry in entries]
        note_coverage(ledger.folder, names, _coverage(found, listed, entries))
    notes = tuple(_notes(found, listed, wanted))
    counts = tally.downloaded, tally.bytes_downloaded, tally.present, tally.bytes_present
    return FetchReport(release, str(destination), tuple(names), *counts, notes)


def _cones(
    cones: Sequence[FetchCone | str],
    everything: bool,
    faintest_g_mag: float | None,
    tap_url: str | None,
) -> list[FetchCone]:
    """The cones asked for, each once and with its limit."""
    if everything == bool(cones):
        raise BadInput("cone", list(cones), "at least one cone, or everything (--all), not both")
    if everything and tap_url is not None:
        raise BadInput("tap_url", tap_url, "cones (the archive's files bring everything)")
    parsed = [parse_cone(cone) if isinstance(cone, str) else cone for cone in cones]
    return list(
        dict.fromkeys(
            replace(cone, faintest_g_mag=faintest_g_mag) if cone.faintest_g_mag is None else cone
            for cone in parsed
        )
    )


def _listed(
    remote: Remote, release: Release, ledger: FileLedger, patience: Patience
) -> list[Entry]:
    """The archive's list of files; it is kept beside them as MD5SUM.txt, where ingest looks."""
    name, failures = release.md5sum_name, 0
    hasty = replace(patience, tries=min(FIRST_TRIES, patience.tries))
    while True:
        try:
            content = read_whole(remote, name, MD5SUM_BYTES)
            break
        except FinalFailure as error:
            allowed = f"the address of a folder that holds {name} ({error})"
            raise BadInput("base_url", remote.address(""), allowed) from None
        except Unavailable as error:
            failures += 1
            hasty.wait(remote.address(name), error, failures, threading.Event())
    entries = parse_md5sum(content.decode("utf-8", "replace"), release, remote.address(name))
    write_whole(ledger.folder, MD5SUM_NAME, content)
    return entries


def _coverage(release: Release, listed: Sequence[Entry], chosen: Sequence[Entry]) -> Coverage:
    """What files of the archive cover: all of the sky, or the pixels of their source_ids."""
    if len(chosen) == len(listed) == release.files:
        return all_sky(f"the whole of {release.title}")
    return files_coverage(release, chosen)


def _by_tap(
    release: Release,
    url: str,
    cones: Sequence[FetchCone],
    ledger: FileLedger,
    patience: Patience,
    tell: Progress,
    verify: bool,
) -> FetchReport:
    service = TapService(release.tap_url if url == ARCHIVE else url, patience)
    names = [file_name(release, cone) for cone in cones]
    brought, there = [], []
    for cone, name in zip(cones, names, strict=True):
        known = ledger.md5_of(name)
        if known is not None and (not verify or file_md5(ledger.folder / name) == known):
            there.append(size_of(ledger.folder / name))
            continue
        fetch_cone(service, release, cone, ledger, lambda done, total: tell("query", done, total))
        brought.append(size_of(ledger.folder / name))
    for cone, name in zip(cones, names, strict=True):
        note_coverage(ledger.folder, [name], cone_coverage(release, cone))
    return FetchReport(
        release.name,
        str(ledger.folder),
        tuple(names),
        len(brought),
        sum(brought),
        len(there),
        sum(there),
        (),
    )


def _notes(release: Release, listed: Sequence[Entry], cones: Sequence[FetchCone]) -> Iterator[str]:
    if len(listed) != release.files:
        yield f"the list names {len(listed)} files; {release.title} has {release.files}"
    if any(cone.faintest_g_mag is not None for cone in cones):
        yield "the archive's files hold all magnitudes: the limit had no effect"


@contextmanager
def _disk(destination: str | Path) -> Iterator[None]:
    """A full disk is unfinished work, as one message."""
    try:
        yield
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        text = f"{destination}: {error.strerror}; make room and run the same command"
        raise Incomplete(text) from None
