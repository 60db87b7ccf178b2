"""Bring LSST reference-catalogue files of real Gaia DR2 sources back to DR2's own columns.

- Positions: radians -> degrees, as they are (J2015.5).
- Fluxes: LSST's converter turned DR2's electrons/s into nJy with the AB zero points of table 5.3
  of the DR2 documentation (G 25.7934, BP 25.3806, RP 25.1161); undone with these, and then DR2's
  VEGAMAG zero points give the published magnitudes. A flux of 0 stands for an absent one.
- Proper motions [rad/yr, though TUNIT says rad]: `pm_ra` includes cos(dec): the column's own
  description (TDOC14) says "dra/dt * cos(dec)". At Dec -1 the two differ by 2e-4 only.
- Motions and parallax are absent (two-parameter solutions) where both errors are 0.
"""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np

COLUMNS = (
    "source_id,ra,dec,parallax,pmra,pmdec,phot_g_mean_mag,phot_bp_mean_mag,phot_rp_mean_mag,"
    "radial_velocity"
)
MAS_RAD = np.pi / 648e6
AB_ZERO_POINT = {"g": 25.7934, "bp": 25.3806, "rp": 25.1161}  # as LSST used them
VEGA_ZERO_POINT = {"g": 25.6883657251, "bp": 25.3513881707, "rp": 24.7619199882}  # DR2


def vega_mag(flux_njy: np.ndarray, band: str) -> np.ndarray:
    """DR2 magnitude (VEGAMAG) of an AB flux [nJy]; NaN where the flux is 0."""
    with np.errstate(divide="ignore"):
        ab_mag = -2.5 * np.log10(flux_njy * 1e-9 / 3631.0)
    mag = ab_mag - AB_ZERO_POINT[band] + VEGA_ZERO_POINT[band]
    return np.where(flux_njy > 0, mag, np.nan)


def convert(folder: Path, out_csv_gz: Path) -> int:
    """Write the rows of all refcat FITS files in `folder` as a DR2 CSV.gz; returns their number."""
    from astropy.io import fits

    lines = [COLUMNS]
    for path in sorted(folder.glob("*_refcats.fits")):
        data = fits.getdata(path, 1)
        moves = (data["pm_raErr"] > 0) & (data["parallaxErr"] > 0)
        columns = [
            np.degrees(data["coord_ra"]),
            np.degrees(data["coord_dec"]),
            *(
                np.where(moves, data[name] / MAS_RAD, np.nan)
                for name in ("parallax", "pm_ra", "pm_dec")
            ),
            *(vega_mag(data[f"phot_{band}_mean_flux"], band) for band in ("g", "bp", "rp")),
        ]
        for source_id, *values in zip(
            data["id"].tolist(), *(c.tolist() for c in columns), strict=True
        ):
            lines.append(
                ",".join([str(source_id), *("" if v != v else repr(v) for v in values), ""])
            )
    out_csv_gz.write_bytes(gzip.compress(("\n".join(lines) + "\n").encode(), mtime=0))
    return len(lines) - 1
