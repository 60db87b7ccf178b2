"""The columns of a catalogue: names, types, units, encodings, and the error each type allows.

| column | type | rounded to | error bound | asked |
| --- | --- | --- | --- | --- |
| `_healpix_29` | int64 | | exact | HATS spatial index, nested, order 29 |
| source_id | int64 | | exact | |
| ra, dec [deg, ICRS] | float64 | 2**-29 deg | 0.0034 mas | 0.01 mas (float32 errs 55 mas) |
| pmra (with cos dec), pmdec [mas/yr] | float32 | 2**-7 | 0.004 mas/yr | 0.01 mas/yr |
| parallax [mas] | float32 | 2**-7 | 0.004 mas | |
| radial_velocity [km/s] | float32 | 2**-7 | 0.004 km/s | |
| phot_{g,bp,rp}_mean_mag [mag, Vega] | float32 | 2**-14 | 0.03 mmag | 0.1 mmag |

A value beyond LIMITS counts as absent: no star has it, and it would make every search look
everywhere. Values are rounded to a power of two: their last bits are zero, which zstd packs away,
and every reader sees plain degrees and magnitudes. An absent value is an Arrow null, never NaN and
never a number.
"""

from __future__ import annotations

import pyarrow as pa

HEALPIX_COLUMN = "_healpix_29"
HEALPIX_ORDER = 29

CANONICAL = pa.schema(
    [
        pa.field("source_id", pa.int64(), nullable=False),
        pa.field("ra", pa.float64(), nullable=False),
        pa.field("dec", pa.float64(), nullable=False),
        pa.field("pmra", pa.float32()),
        pa.field("pmdec", pa.float32()),
        pa.field("parallax", pa.float32()),
        pa.field("radial_velocity", pa.float32()),
        pa.field("phot_g_mean_mag", pa.float32(), nullable=False),
        pa.field("phot_bp_mean_mag", pa.float32()),
        pa.field("phot_rp_mean_mag", pa.float32()),
    ]
)
NAMES: tuple[str, ...] = tuple(CANONICAL.names)
REQUIRED: tuple[str, ...] = ("source_id", "ra", "dec", "phot_g_mean_mag")

# What a reader yields: the same columns, any of them may be null until the rows are judged.
INCOMING = pa.schema([pa.field(f.name, f.type) for f in CANONICAL])

# What a shard holds.
STORED = CANONICAL.insert(0, pa.field(HEALPIX_COLUMN, pa.int64(), nullable=False))

# Sorted integers shrink as differences; the bytes of floats compress better plane by plane.
ENCODINGS: dict[str, str] = {
    field.name: "DELTA_BINARY_PACKED" if pa.types.is_integer(field.type) else "BYTE_STREAM_SPLIT"
    for field in STORED
}

# Steps to which values are rounded on the way in.
STEPS: dict[str, float] = {
    **dict.fromkeys(("ra", "dec"), 2.0**-29),
    **dict.fromkeys(("pmra", "pmdec", "parallax", "radial_velocity"), 2.0**-7),
    **{f"phot_{band}_mean_mag": 2.0**-14 for band in ("g", "bp", "rp")},
}

# The largest absolute values that are taken for measurements; ra and dec have reasons of their own.
LIMITS: dict[str, float] = {
    **dict.fromkeys(("ra", "dec"), 1e300),
    **dict.fromkeys(("pmra", "pmdec"), 1e5),  # mas/yr; Barnard's star: 10,400
    "parallax": 1e4,  # mas; Proxima Centauri: 768
    "radial_velocity": 1e5,  # km/s
    **{f"phot_{band}_mean_mag": 60.0 for band in ("g", "bp", "rp")},
}
UNITS: dict[str, str] = {
    **dict.fromkeys(("ra", "dec"), "deg"),
    **dict.fromkeys(("pmra", "pmdec"), "mas/yr"),
    "parallax": "mas",
    "radial_velocity": "km/s",
    **{f"phot_{band}_mean_mag": "mag" for band in ("g", "bp", "rp")},
}
