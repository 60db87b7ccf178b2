"""Where an observer or a target moves: mean elements, a state, Keplerian elements, or a table."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from pipeline.spec.strict import FilePath, NotNegative, Strict

MOST_ROWS = 20_000  # of a table that a scene holds itself
Metres = Annotated[float, Field(ge=-1e13, le=1e13)]
MetresPerSecond = Annotated[float, Field(ge=-1e9, le=1e9)]
Place = tuple[Metres, Metres, Metres]
Speed = tuple[MetresPerSecond, MetresPerSecond, MetresPerSecond]
Angle = Annotated[float, Field(ge=-360, le=360)]
Turns = Annotated[float, Field(ge=-1e9, le=1e9)]
Inclination = Annotated[float, Field(ge=0, le=180)]
Utc = Annotated[str, Field(min_length=1, max_length=40)]
AreaToMass = Annotated[float, Field(ge=0, le=100)]


class TleOrbit(Strict):
    """A NORAD two-line element set, propagated by SGP4 (WGS 72)."""

    kind: Literal["tle"]
    line1: str = Field(max_length=80)
    line2: str = Field(max_length=80)


class StateOrbit(Strict):
    """A geocentric position and velocity in GCRS axes at `epoch` (default: the scene's epoch)."""

    kind: Literal["state"]
    position_m: Place
    velocity_m_s: Speed
    epoch: str | None = Field(None, max_length=40)


class MeanElements(Strict):
    """Mean elements of SGP4 in TEME axes, as an Orbit Mean-Elements Message carries them."""

    epoch: Utc
    mean_motion_rev_day: float = Field(ge=1e-8, le=20)  # the least: 9.1e12 m, a TLE's last digit
    eccentricity: float = Field(ge=0, lt=1)
    inclination_deg: Inclination
    raan_deg: Angle
    argument_of_perigee_deg: Angle
    mean_anomaly_deg: Angle
    bstar: float = Field(0.0, ge=-10, le=10, description="drag term [1 / Earth radii]")


def _one_of(model: object, *names: str) -> None:
    """Exactly one of these fields must be given."""
    given = [name for name in names if getattr(model, name) is not None]
    if len(given) != 1:
        raise PydanticCustomError(
            "one_of", "allowed: exactly one of {names}", {"names": ", ".join(names)}
        )


Pick = Annotated[
    str | None,
    Field(max_length=80, description="object name, number or id, where a file holds several"),
]


class OmmOrbit(Strict):
    """An Orbit Mean-Elements Message: a JSON, KVN or XML file, or the elements themselves."""

    kind: Literal["omm"]
    path: FilePath | None = None
    object: Pick = None
    elements: MeanElements | None = None

    @model_validator(mode="after")
    def _file_or_elements(self) -> OmmOrbit:
        _one_of(self, "path", "elements")
        return self


class KeplerianOrbit(Strict):
    """Two-body motion of any eccentricity from osculating elements in GCRS axes.

    One length: `semi_major_axis_m` (negative for a hyperbola, none for a parabola) or
    `perigee_radius_m`. One phase at `epoch` (default: the scene's): a true or mean anomaly, or the
    time of a perigee.
    """

    kind: Literal["keplerian"]
    semi_major_axis_m: Metres | None = None
    perigee_radius_m: Annotated[float, Field(gt=0, le=1e13)] | None = None
    eccentricity: float = Field(ge=0, le=1e6)
    inclination_deg: Inclination
    raan_deg: Angle = 0.0
    argument_of_perigee_deg: Angle = 0.0
    true_anomaly_deg: Angle | None = None
    mean_anomaly_deg: Turns | None = None
    time_of_perigee: Utc | None = None
    epoch: Utc | None = None
    frame: Literal["gcrs"] = "gcrs"

    @model_validator(mode="after")
    def _one_length_and_one_phase(self) -> KeplerianOrbit:
        _one_of(self, "semi_major_axis_m", "perigee_radius_m")
        _one_of(self, "true_anomaly_deg", "mean_anomaly_deg", "time_of_perigee")
        a, e = self.semi_major_axis_m, self.eccentricity
        if a is not None and not a * (1.0 - e) > 0.0:
            raise PydanticCustomError(
                "axis",
                "allowed: above 0 for an ellipse, below 0 for a hyperbola; for a parabola give "
                "perigee_radius_m",
                {"field": "semi_major_axis_m"},
            )
        if e == 1.0 and self.mean_anomaly_deg is not None:
            raise PydanticCustomError(
                "anomaly",
                "allowed: true_anomaly_deg or time_of_perigee: a parabola has no mean anomaly",
                {"field": "mean_anomaly_deg"},
            )
        return self


class NumericalOrbit(Strict):
    """A state (GCRS) carried on by numerical integration of the forces that are asked for."""

    kind: Literal["numerical"]
    position_m: Place
    velocity_m_s: Speed
    epoch: Utc | None = Field(None, description="UTC of the state; default: the scene's epoch")
    zonals: Literal[0, 2, 3, 4, 5, 6] = Field(6, description="highest zonal harmonic; 0: none")
    drag_m2_kg: AreaToMass = Field(0.0, description="ballistic coefficient C_D A/m; 0: no drag")
    radiation_m2_kg: AreaToMass = Field(
        0.0, description="radiation coefficient C_R A/m of a sphere; 0: no radiation pressure"
    )
    shadow: Literal["conical", "cylindrical"] = "conical"
    third_bodies: tuple[Literal["sun", "moon"], ...] = ()
    relative_tolerance: float = Field(1e-11, ge=1e-13, le=1e-6)


class EphemerisOrbit(Strict):
    """A file of places: CCSDS OEM (KVN), SP3-c or d, or CSV with units in its column names.

    CSV columns: `time_utc` (or `time_tt`, `time_tai`, `time_gps`, `time_s` after `epoch`), `x_m`,
    `y_m`, `z_m` (or _km), and where known `vx_m_s`, `vy_m_s`, `vz_m_s` (or _km_s); `frame` is
    required for CSV, and for others it must agree with the file.
    """

    kind: Literal["ephemeris"]
    path: FilePath
    object: Pick = None
    frame: Literal["gcrs", "eme2000", "itrf", "teme"] | None = None
    epoch: Utc | None = Field(None, description="zero of a CSV file's time_s")


class TableOrbit(Strict):
    """Places in GCRS axes at seconds (TAI) after `epoch`, interpolated by polynomials.

    rows : time [s], x, y, z [m] and, in all rows or in none, vx, vy, vz [m/s], by increasing time
    nodes : rows that each polynomial passes; default: as many as err least on rows kept aside
    """

    kind: Literal["table"]
    epoch: Utc
    rows: tuple[tuple[float, ...], ...] = Field(min_length=2, max_length=MOST_ROWS)
    nodes: int | None = Field(None, ge=2, le=16)
    error_m: NotNegative | None = Field(None, description="largest error on rows kept aside [m]")
    source: str = Field("", max_length=200, description="where the rows are from")

    @field_validator("rows")
    @classmethod
    def _even_rows_in_order(
        cls, rows: tuple[tuple[float, ...], ...]
    ) -> tuple[tuple[float, ...], ...]:
        width = len(rows[0])
        for i, row in enumerate(rows):
            if len(row) != width or width not in (4, 7):
                raise PydanticCustomError(
                    "row", "allowed: 4 numbers in every row, or 7", {"index": i}
                )
            if i and not row[0] > rows[i - 1][0]:
                raise PydanticCustomError("row", "allowed: increasing times", {"index": i})
            if max(map(abs, row)) > 1e13:
                raise PydanticCustomError("row", "allowed: numbers up to 1e13", {"index": i})
        return rows


Orbit = Annotated[
    TleOrbit
    | StateOrbit
    | OmmOrbit
    | KeplerianOrbit
    | NumericalOrbit
    | EphemerisOrbit
    | TableOrbit,
    Field(discriminator="kind"),
]
