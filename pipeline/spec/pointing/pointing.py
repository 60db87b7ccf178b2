"""Where the sensor points and how it tracks."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from pipeline.spec.pointing.attitude import AttitudeModel
from pipeline.spec.strict import FilePath, Strict

Turn_deg = Annotated[float, Field(ge=-360, le=360)]
Rate = Annotated[float, Field(ge=-1e7, le=1e7)]  # arcsec/s or arcsec/s2: what can be drawn is less

MOST_ROWS = 20_000  # of a table that a scene holds itself
RightAscension = Annotated[float, Field(ge=-360, le=360)]
Declination = Annotated[float, Field(ge=-90, le=90)]
Utc = Annotated[str, Field(min_length=1, max_length=40)]
Number = Annotated[float, Field(ge=-1e12, le=1e12)]
Quaternion = tuple[Number, Number, Number, Number]
QuaternionRow = tuple[Number, Number, Number, Number, Number]


class Held(Strict):
    """What all kinds of pointing share."""

    attitude: AttitudeModel | None = Field(None, description="drift, jitter, flexible modes")


class SiderealPointing(Held):
    """Hold an ICRS direction at the centre of the frame, as a guided telescope does."""

    mode: Literal["sidereal"]
    boresight_ra_deg: RightAscension
    boresight_dec_deg: Declination
    roll_deg: Turn_deg = Field(0.0, description="position angle of +y, from north through east")


class RatePointing(Held):
    """Drift from the boresight at the dwell's start, with rates and accelerations of that moment.

    Without acceleration along a great circle. With it the boresight stands rate t + acceleration
    t^2 / 2 from where it started, as an arc in the direction of that vector.
    """

    mode: Literal["rate"]
    boresight_ra_deg: RightAscension
    boresight_dec_deg: Declination
    rate_ra_arcsec_s: Rate = Field(description="on the sky: includes cos dec")
    rate_dec_arcsec_s: Rate
    acceleration_ra_arcsec_s2: Rate = 0.0
    acceleration_dec_arcsec_s2: Rate = 0.0
    roll_deg: Turn_deg = 0.0
    roll_rate_deg_s: float = Field(
        0.0, ge=-1e4, le=1e4, description="rate of the roll, from the start [deg/s]"
    )


class TargetPointing(Held):
    """Keep a target at the centre of the frame (rate track)."""

    mode: Literal["target"]
    target: str
    roll_deg: Turn_deg = 0.0


class LocalPointing(Held):
    """Hold a direction fixed to a site on the ground, or to the local frame of an orbit.

    Ground: azimuth from north through east, elevation above the horizon of the ellipsoid; the sky
    drifts through the field. Orbit: azimuth from the direction of flight to the right, elevation
    above the local horizontal (-90 is nadir). No refraction.
    """

    mode: Literal["local"]
    azimuth_deg: RightAscension
    elevation_deg: Declination
    roll_deg: Turn_deg = Field(0.0, description="angle of +y, from the zenith to the left [deg]")


class TablePointing(Held):
    """Attitudes from a table of unit quaternions over time: a file, or rows in the scene.

    The quaternions' camera is right-handed: z the boresight, y up the rows, x against the columns.

    rows : seconds (TAI) after `epoch`, then the four numbers in the order that `scalar` names
    scalar : where the scalar part stands; a file may name its columns qx, qy, qz, qw instead
    rotation : what v' = q v q* does to a vector's components
    frame : icrs, the axes among catalogue places (aberration moves the stars with the boresight);
        gcrs, the axes in space, where the moving observer sees the stars aberrated
    mounting : quaternion camera to body, where the table is of the body; `scalar` as for the rows
    """

    mode: Literal["table"]
    path: FilePath | None = Field(None, description="CSV, FITS, NPY or Parquet")
    rows: Annotated[tuple[QuaternionRow, ...], Field(min_length=2, max_length=MOST_ROWS)] | None = (
        None
    )
    scalar: Literal["first", "last"] | None = None
    rotation: Literal["camera_to_sky", "sky_to_camera"] = "camera_to_sky"
    frame: Literal["icrs", "gcrs"]
    mounting: Quaternion | None = None
    interpolation: Literal["slerp", "spline"] = "slerp"
    epoch: Utc | None = Field(None, description="zero of the seconds; default: the scene's epoch")
    error_arcsec: float | None = Field(
        None, ge=0, description="error measured on rows kept aside [arcsec]"
    )
    source: str | None = Field(None, max_length=200)

    @model_validator(mode="after")
    def _file_or_rows(self) -> TablePointing:
        if (self.path is None) == (self.rows is None):
            raise PydanticCustomError("one_of", "allowed: exactly one of path, rows", {})
        if self.rows is not None and self.scalar is None:
            raise PydanticCustomError(
                "scalar",
                "allowed: first or last, where the scalar part stands in the rows",
                {"field": "scalar"},
            )
        return self


Pointing = Annotated[
    SiderealPointing | RatePointing | TargetPointing | LocalPointing | TablePointing,
    Field(discriminator="mode"),
]
