"""A form as plain frozen values: where each canonical column comes from, and in which units."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import log10, pi
from types import MappingProxyType

from ..errors import BadInput

_DEG = {
    "deg": 1.0,
    "rad": 180.0 / pi,
    "hourangle": 15.0,
    "arcmin": 1 / 60.0,
    "arcsec": 1 / 3600.0,
    "mas": 1 / 3.6e6,
    "uas": 1 / 3.6e9,
}
_MAS = {name: factor * 3.6e6 for name, factor in _DEG.items() if name != "hourangle"}
_FLUX_JY = {"Jy": 1.0, "mJy": 1e-3, "uJy": 1e-6, "nJy": 1e-9}
_MAG = {"mag": 1.0, "flux": 1.0, **_FLUX_JY}
_VELOCITY = {"km/s": 1.0, "m/s": 1e-3}
_MOTION = {f"{name}/yr": factor for name, factor in _MAS.items()}

# Factors from a unit to the canonical one, by column.
UNITS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        **dict.fromkeys(("ra", "dec"), _DEG),
        **dict.fromkeys(("pmra", "pmdec"), _MOTION),
        "parallax": _MAS,
        "radial_velocity": _VELOCITY,
        **{f"phot_{band}_mean_mag": _MAG for band in ("g", "bp", "rp")},
    }
)
AB_JY = 3631.0  # the flux of AB magnitude 0, Oke & Gunn 1983, ApJ 266, 713
MU_ALPHA_STAR, MU_ALPHA = "mu_alpha_star", "mu_alpha"
ID_RULES = ("integer", "trailing_integer", "position", "text")
EPOCH_UNITS = ("jyear", "mjd", "jd")
LAYOUTS = ("delimited", "whitespace", "fixed")


@dataclass(frozen=True)
class ColumnSource:
    """One way to get the values of a canonical column.

    value = names * factor [unit], as a canonical value, + add + sum_k coefficients[k] colour**k.
    names : columns of the table; the first that it has is taken. unit : a key of UNITS[column];
    a flux in Jy becomes an AB magnitude, one in `flux` becomes -2.5 log10(flux). nulls : numbers
    that stand for an absent value, in `names` and in `colour`. positive : columns that must be
    above 0 for a value to be there. colour : one column, or two whose difference it is; outside
    colour_range the value is absent, or the colour is taken at the end of the range where `clip`.
    is_ : for pmra, whether cos(dec) is in it. optional : the table may lack the column. fallback :
    this way is for tables that offer none of the earlier ones and have all of its columns.
    """

    column: str
    names: tuple[str, ...]
    unit: str
    factor: float = 1.0
    add: float = 0.0
    nulls: tuple[float, ...] = ()
    positive: tuple[str, ...] = ()
    colour: tuple[str, ...] = ()
    coefficients: tuple[float, ...] = ()
    colour_range: tuple[float, float] | None = None
    clip: bool = False
    is_: str | None = None
    optional: bool = False
    fallback: bool = False

    def is_offered(self, table: Names) -> bool:
        """Whether a table may be asked for it: one that lacks its columns either does without it
        (optional, fallback), or is refused where they are looked for."""
        if self.fallback:
            needed = (self.names, *((name,) for name in (*self.positive, *self.colour)))
            return all(table.first(names) is not None for names in needed)
        return not self.optional or table.first(self.names) is not None

    @property
    def scale(self) -> float:
        """From the table's numbers to the canonical unit; to Jy for a flux."""
        return self.factor * UNITS[self.column][self.unit]

    @property
    def is_flux(self) -> bool:
        return self.unit == "flux" or self.unit in _FLUX_JY

    @property
    def zero_mag(self) -> float:
        """Magnitude of the flux 1: 1 Jy in AB magnitudes, or 0 for a flux of unnamed unit."""
        return 2.5 * log10(AB_JY) if self.unit in _FLUX_JY else 0.0

    @property
    def is_plain(self) -> bool:
        """Whether the table's numbers are the values."""
        extra = self.nulls or self.positive or self.colour or self.is_flux
        return self.scale == 1.0 and self.add == 0.0 and not extra and self.is_ != MU_ALPHA


@dataclass(frozen=True)
class IdRule:
    """How a row gets its source_id.

    `integer`: a column of integers, times `factor`. `trailing_integer`: the digits that end a
    text, as in "Gaia DR2 123", times `factor`. `position`: -1 - pixel, the nested HEALPix pixel
    of order 29 (0.4 mas); rows of one pixel are duplicates. `text`: 62 bits of the BLAKE2b hash
    of the text, minus 2**63. The last two are negative, and so never an id of Gaia.
    holds_place : whether they are Gaia's, from which a row's place follows (`gaia_ids`).
    """

    rule: str
    names: tuple[str, ...] = ()
    factor: int = 1
    holds_place: bool = False


@dataclass(frozen=True)
class Epoch:
    """Columns with the epoch of a row, and their unit: all rows must be of the form's epoch.

    A form that names none takes Gaia's `ref_epoch`, where a file has it.
    """

    names: tuple[str, ...]
    unit: str = "jyear"


@dataclass(frozen=True)
class Layout:
    """What a file's first bytes don't say.

    text : how a text table is laid out. columns : names where it has no header line, or for
    `fixed`, with the first and last byte of each, counted from 1. comments : how lines before
    the header begin. nulls : texts that stand for an absent value. hdu : which extension of a
    FITS file. query, attach : what to ask an SQLite file, and files to attach, by their alias.
    """

    text: str = "delimited"
    delimiter: str = ","
    columns: tuple[str, ...] = ()
    ranges: tuple[tuple[int, int], ...] = ()
    comments: tuple[str, ...] = ("#",)
    nulls: tuple[str, ...] = ()
    hdu: int | None = None
    query: str | None = None
    attach: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Form:
    """What a kind of table means.

    sources : in the order of trial where a column has several. foreign : columns that a table of
    this kind can't have; one that has them is of another kind, and refused.
    """

    name: str
    description: str
    credit: str
    ref_epoch_jyear: float
    epoch_scale: str
    source_id: IdRule
    sources: tuple[ColumnSource, ...]
    epoch: Epoch = Epoch(("ref_epoch",))
    layout: Layout = Layout()
    foreign: tuple[str, ...] = ()

    def of(self, column: str) -> tuple[ColumnSource, ...]:
        return tuple(source for source in self.sources if source.column == column)

    def ways(self, column: str, table: Names) -> tuple[ColumnSource, ...]:
        """The ways to a canonical column that a table offers, in the order of trial."""
        found: list[ColumnSource] = []
        for source in self.of(column):
            if source.is_offered(table) and not (source.fallback and found):
                found.append(source)
        return tuple(found)

    def choose(self, names: Iterable[str], where: str) -> dict[str, str]:
        """The columns to read of a table with these columns: `integer`, `number` or `text` by name.

        where : the file, for the message. Raises BadInput where a column is missing or foreign.
        """
        table = Names(names)
        if (other := table.first(self.foreign)) is not None:
            raise BadInput(f"{where} {other}", other, f"the columns of the form {self.name}")
        chosen: dict[str, str] = {}
        if self.source_id.rule != "position":
            kind = "integer" if self.source_id.rule == "integer" else "text"
            chosen[self._find(table, self.source_id.names, where, "source_id")] = kind
        for column in dict.fromkeys(source.column for source in self.sources):
            for source in self.ways(column, table):
                chosen.setdefault(self._find(table, source.names, where, column), "number")
                for name in (*source.positive, *source.colour):
                    chosen.setdefault(self._find(table, (name,), where, column), "number")
        if (found := table.first(self.epoch.names)) is not None:
            chosen.setdefault(found, "number")
        return chosen

    def _find(self, table: Names, names: tuple[str, ...], where: str, column: str) -> str:
        found = table.first(names)
        if found is None:
            wanted = " or ".join(repr(name) for name in names)
            allowed = f"a table with column {wanted} ({column} of the form {self.name})"
            raise BadInput(where, sorted(table.all), allowed)
        return found


class Names:
    """The column names of a table; found as written, else in any case where that is unique."""

    def __init__(self, names: Iterable[str]) -> None:
        self.all = list(names)
        self._folded: dict[str, str | None] = {}
        for name in self.all:
            low = name.lower()
            self._folded[low] = None if low in self._folded else name
        self._exact = set(self.all)

    def first(self, wanted: Iterable[str]) -> str | None:
        for name in wanted:
            found = name if name in self._exact else self._folded.get(name.lower())
            if found is not None:
                return found
        return None
