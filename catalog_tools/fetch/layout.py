"""What the archive publishes and where: releases, their lists of files, the files of a cone.

DR2 names its files by the smallest and largest source_id inside, DR3 by the first and last nested
HEALPix pixel of order 8; both break between pixels of order 12. `source_id >> 35` is the order-12
pixel of the place that the source had when it got its identifier (DR2 documentation 10.2.1).
"""

from __future__ import annotations

import html
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from ..coverage import Coverage, of_pixels
from ..errors import BadInput
from ..geometry.gaia_ids import ID_ORDER, ID_SHIFT, MOVED_DEG
from ..partition import COUNT_ORDER
from .cones import FetchCone

DR2_NAME = re.compile(r"GaiaSource_(\d{1,19})_(\d{1,19})\.csv\.gz")
DR3_NAME = re.compile(r"GaiaSource_(\d{6})-(\d{6})\.csv\.gz")
MD5_LINE = re.compile(r"([0-9a-fA-F]{32})[ \t]+\*?(\S.*)")
INDEX_ROW = re.compile(r'href="([^"?]+)"[^>]*>[^<]*</a>[^<]*?(\d+(?:\.\d+)?)([KMG]?)\s*(?=[\r\n<])')
UNITS = {"": 1, "K": 1 << 10, "M": 1 << 20, "G": 1 << 30}


@dataclass(frozen=True)
class Release:
    """A data release: where its files and its TAP service are, and how the files are named."""

    name: str
    title: str
    ref_epoch_jyear: float
    base_url: str
    md5sum_name: str
    files: int
    file_name: re.Pattern[str]
    number_shift: int  # from the numbers in a file's name to a source_id
    tap_url: str
    table: str


ARCHIVE_TAP = "https://gea.esac.esa.int/tap-server/tap"
CDN = "https://cdn.gea.esac.esa.int/Gaia"
RELEASES = {
    release.name: release
    for release in (
        Release(
            "gaia-dr2",
            "Gaia DR2",
            2015.5,
            f"{CDN}/gdr2/gaia_source/csv/",
            "MD5SUM.txt",
            61_234,
            DR2_NAME,
            0,
            ARCHIVE_TAP,
            "gaiadr2.gaia_source",
        ),
        Release(
            "gaia-dr3",
            "Gaia DR3",
            2016.0,
            f"{CDN}/gdr3/gaia_source/",
            "_MD5SUM.txt",
            3_386,
            DR3_NAME,
            ID_SHIFT + 2 * (ID_ORDER - 8),
            ARCHIVE_TAP,
            "gaiadr3.gaia_source",
        ),
    )
}


@dataclass(frozen=True)
class Entry:
    """A file of the archive: its name, MD5, and the source_ids that it may hold (inclusive)."""

    name: str
    md5: str
    first_id: int
    last_id: int


def release_named(name: str) -> Release:
    """The release of that name; BadInput where there is none."""
    if name not in RELEASES:
        raise BadInput("release", name, " or ".join(RELEASES))
    return RELEASES[name]


def parse_md5sum(text: str, release: Release, where: str) -> list[Entry]:
    """The files of rows that a list of MD5 digests names, by first source_id.

    where : the list's address, for messages. Other names (`_citation.txt`) are omitted. Raises
    BadInput at the first line that is not `digest  name`, at a name of impossible ids, at a name
    with two digests, and for a list that names no file of the release.
    """
    entries: dict[str, Entry] = {}
    for number, raw in enumerate(text.splitlines(), 1):
        line = raw.strip()
        if not line or line.startswith("#"):
            continue
        match = MD5_LINE.fullmatch(line)
        if not match:
            raise BadInput(f"{where} line {number}", line, "an MD5 digest and a file name")
        entry = _entry(match[1].lower(), PurePosixPath(match[2]).name, release)
        if entry is None:
            continue
        if entry.first_id > entry.last_id or entry.last_id >> 63:
            raise BadInput(f"{where} line {number}", line, "a file named by ascending source_ids")
        if entries.setdefault(entry.name, entry) != entry:
            raise BadInput(f"{where} line {number}", line, "one digest for each file")
    if not entries:
        raise BadInput(where, text[:200], f"a list of {release.title}'s GaiaSource files")
    return sorted(entries.values(), key=lambda entry: (entry.first_id, entry.name))


def _entry(md5: str, name: str, release: Release) -> Entry | None:
    match = release.file_name.fullmatch(name)
    if not match:
        return None
    shift = release.number_shift
    last = (int(match[2]) << shift) + (1 << shift) - 1
    return Entry(name, md5, int(match[1]) << shift, last)


def parse_index(text: str) -> dict[str, int]:
    """Sizes in bytes by name from a web server's directory listing; rounded as the server does.

    Names come from the links: what is shown of long names is cut.
    """
    return {
        unquote(html.unescape(link)): math.ceil(float(number) * UNITS[unit])
        for link, number, unit in INDEX_ROW.findall(text)
    }


def choose(entries: Sequence[Entry], cones: Sequence[FetchCone]) -> list[Entry]:
    """The files that may hold a source which stands in one of the cones at the release's epoch.

    Each cone is widened by MOVED_DEG and by a ring of pixels; see there what this may miss.
    """
    first = np.array([entry.first_id for entry in entries], np.int64) >> ID_SHIFT
    last = np.array([entry.last_id for entry in entries], np.int64) >> ID_SHIFT
    hit = np.zeros(len(entries), bool)
    for cone in cones:
        starts, ends = cone_ranges(cone)
        before = np.searchsorted(starts, last, side="right") - 1
        hit |= (before >= 0) & (ends[before] > first)
    return [entry for entry, chosen in zip(entries, hit, strict=True) if chosen]


def files_coverage(release: Release, entries: Sequence[Entry]) -> Coverage:
    """The part of the sky that files bring whole: from each one's first source_id to its last.

    In pixels of COUNT_ORDER (7 arcmin), so that files which follow each other leave no gap.
    """
    shift = ID_SHIFT + 2 * (ID_ORDER - COUNT_ORDER)
    first = np.array([entry.first_id for entry in entries], np.int64) >> shift
    last = np.array([entry.last_id for entry in entries], np.int64) >> shift
    last = np.minimum(last, (12 << (2 * COUNT_ORDER)) - 1)
    return of_pixels(f"fetched files of {release.title}", COUNT_ORDER, first, last + 1)


def cone_ranges(cone: FetchCone) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Half-open ranges of order-12 pixels (starts, ends), ascending and apart, about a cone.

    They hold every pixel that comes within MOVED_DEG of the cone, and a ring of neighbours. Wide
    cones are covered by coarser pixels: never fewer, at most some 60,000.
    """
    import healpy

    radius_deg = cone.radius_deg + MOVED_DEG
    if radius_deg >= 180.0:
        return np.array([0]), np.array([12 << (2 * ID_ORDER)])
    order = min(ID_ORDER, max(6, ID_ORDER - math.ceil(math.log2(radius_deg / 1.5))))
    nside = 1 << order
    centre = healpy.ang2vec(cone.ra_deg, cone.dec_deg, lonlat=True)
    inside = healpy.query_disc(nside, centre, math.radians(radius_deg), inclusive=True, nest=True)
    ring = healpy.get_all_neighbours(nside, inside, nest=True).ravel()
    pixels = np.union1d(inside, ring[ring >= 0]).astype(np.int64)
    breaks = np.flatnonzero(np.diff(pixels) > 1)
    shift = 2 * (ID_ORDER - order)
    starts = pixels[np.concatenate([[0], breaks + 1])] << shift
    ends = (pixels[np.concatenate([breaks, [pixels.size - 1]])] + 1) << shift
    return starts, ends
