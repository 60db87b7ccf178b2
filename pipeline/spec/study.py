"""The study file: sensors, a catalogue, a period, tasking; what is to be found of capacity."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from catalog_tools.documents import JsonObject
from pipeline.spec.pointing.observer import GroundObserver, OrbitObserver
from pipeline.spec.scene import Exposure
from pipeline.spec.sensor.sensor import Sensor
from pipeline.spec.sky.background import Background
from pipeline.spec.strict import Fraction, Positive, Strict
from pipeline.spec.sweep import (
    Axis,
    DesignWish,
    Grid,
    axes_with_kinds,
    check_fields,
    check_lengths,
    points_of,
)
from pipeline.spec.targets.population import MOST_POPULATIONS, Population

SCHEMA = "nightglass/study/1"
FIXED = ("schema", "name", "axes", "design", "seeds")  # what every point has in common
MOST_SENSORS, MOST_OBJECTS, MOST_RULES, MOST_STUDY_POINTS = 256, 1_000_000, 1000, 1000

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")]
Degrees = Annotated[float, Field(ge=0, le=180)]
Diameter = Annotated[float, Field(ge=1e-4, le=1e4)]  # [m]


class FieldOfRegard(Strict):
    """Where and when a sensor may look.

    Elevations are of a site, as the air shows them; `earth_exclusion_deg` is of a satellite, above
    the Earth's limb; `twilight_deg` is the Sun's highest elevation at a site; of the sky's hours a
    `clear_fraction` is clear, in stretches of `weather_h`, drawn by the seed
    """

    lowest_elevation_deg: float = Field(20.0, ge=0, lt=90)
    highest_elevation_deg: float = Field(90.0, gt=0, le=90)
    sun_exclusion_deg: Degrees = 30.0
    moon_exclusion_deg: Degrees = 10.0
    earth_exclusion_deg: float = Field(5.0, ge=0, le=90)
    galactic_exclusion_deg: float = Field(0.0, ge=0, lt=90)
    twilight_deg: float = Field(-12.0, ge=-18, le=0)
    clear_fraction: float = Field(1.0, gt=0, le=1)
    weather_h: float = Field(6.0, gt=0, le=1000)

    @model_validator(mode="after")
    def _elevations_rise(self) -> FieldOfRegard:
        if not self.lowest_elevation_deg < self.highest_elevation_deg:
            raise PydanticCustomError(
                "elevations",
                "allowed: above lowest_elevation_deg = {low}",
                {"low": self.lowest_elevation_deg, "field": "highest_elevation_deg"},
            )
        return self


class StudyCamera(Strict):
    """Optics and detector as in a scene, with the exposures of one dwell and how they track."""

    name: Name
    sensor: Sensor
    exposure: Exposure
    background: Background | None = None
    tracking: Literal["target", "sidereal"] = "sidereal"

    @model_validator(mode="after")
    def _sees_light(self) -> StudyCamera:
        if self.exposure.integration_s == 0.0:
            told = {"field": "exposure.integration_s"}
            raise PydanticCustomError("bias", "allowed: above 0, to see light", told)
        return self


class Slewing(Strict):
    """Time from one dwell to the next: the angle over the rate, and then the settling."""

    rate_deg_s: Positive = 3.0
    settle_s: float = Field(5.0, ge=0, le=3600)


class StudySensor(Strict):
    """A camera at a site or on an orbit; `count` of them work there side by side."""

    name: Name
    camera: Name | None = Field(None, description="name of its camera; default: the first")
    count: int = Field(1, ge=1, le=64)
    observer: Annotated[GroundObserver | OrbitObserver, Field(discriminator="kind")]
    field_of_regard: FieldOfRegard = FieldOfRegard()
    slewing: Slewing = Slewing()


class Synthetic(Strict):
    """Made-up objects: four fifths in low orbits, the rest in 12-hour, 24-hour and long ones.

    Diameters follow N(>d) ~ d^-1.6 between the two
    """

    objects: int = Field(ge=1, le=MOST_OBJECTS)
    seed: int = Field(0, ge=0, lt=2**63)
    smallest_m: Diameter = 0.3
    largest_m: Diameter = 10.0
    albedo: Fraction = 0.175

    @model_validator(mode="after")
    def _sizes_rise(self) -> Synthetic:
        if self.smallest_m > self.largest_m:
            told = {"low": self.smallest_m, "field": "largest_m"}
            raise PydanticCustomError("sizes", "allowed: smallest_m = {low} or more", told)
        return self


class ObjectCatalogue(Strict):
    """What is looked for: populations as scenes have them, or made-up objects.

    most_age_days : elements older or younger than that against the period are omitted
    """

    populations: tuple[Population, ...] = Field((), max_length=MOST_POPULATIONS)
    synthetic: Synthetic | None = None
    most_age_days: float = Field(30.0, gt=0, le=36_500)

    @model_validator(mode="after")
    def _some(self) -> ObjectCatalogue:
        if not self.populations and self.synthetic is None:
            raise PydanticCustomError("objects", "allowed: populations, synthetic or both")
        return self


class PriorityRule(Strict):
    """Objects by part of their name or by catalogue number: their priority, how often wanted."""

    name_contains: str | None = Field(None, min_length=1, max_length=40)
    numbers: tuple[int, ...] = Field((), max_length=100_000)
    priority: float = Field(1.0, ge=0, le=1e6, description="0: never tasked")
    revisit_h: float | None = Field(None, gt=0, le=100_000)


class CuedTasking(Strict):
    """Sensors are sent to objects: those most overdue for their priority first.

    scheduler : `greedy` takes one sensor after another, `assignment` all free ones together
        (scipy's linear_sum_assignment); rules : priorities; the first that names an object counts
    """

    kind: Literal["cued"]
    scheduler: Literal["greedy", "assignment"] = "greedy"
    revisit_h: float = Field(12.0, gt=0, le=100_000)
    rules: tuple[PriorityRule, ...] = Field((), max_length=MOST_RULES)


class SearchPattern(Strict):
    """Sensors step through fields whatever is there, each held for one dwell.

    fence : from one elevation to another along an azimuth; belt : the geostationary ring as a site
    sees it, between two longitudes; strip : right ascensions about the one opposite the Sun, at
    one declination
    """

    kind: Literal["serendipitous"]
    pattern: Literal["fence", "belt", "strip"]
    azimuth_deg: float = Field(180.0, ge=0, le=360)
    from_deg: float = Field(30.0, ge=-360, le=360)
    to_deg: float = Field(80.0, ge=-360, le=360)
    declination_deg: float = Field(0.0, ge=-90, le=90)
    overlap: float = Field(
        0.1, ge=0, lt=0.9, description="overlap of neighbouring fields, as a fraction"
    )

    @model_validator(mode="after")
    def _rises(self) -> SearchPattern:
        if not self.from_deg < self.to_deg:
            raise PydanticCustomError(
                "span", "allowed: above from_deg = {low}", {"low": self.from_deg, "field": "to_deg"}
            )
        return self


class StudyDetection(Strict):
    """A matched filter on Gaussian noise: an object counts above a threshold.

    false_alarm_rate : probability of a false alarm at one test of one object in one frame;
    frames_needed : frames of a dwell in which an object must be detected
    """

    false_alarm_rate: float = Field(1e-6, gt=0, lt=0.5)
    frames_needed: int = Field(1, ge=1, le=1000)
    least_probability: float = Field(
        0.05, ge=0, lt=1, description="least probability of detection for an object to be tasked"
    )


class Study(Strict):
    """A study file, version 1."""

    schema_: Literal["nightglass/study/1"] = Field(alias="schema")
    name: Name
    seed: int = Field(0, ge=0, lt=2**63)
    start: str = Field(max_length=40, description="start of the period, UTC")
    duration_h: float = Field(gt=0, le=24 * 3660)
    step_s: float = Field(
        60.0,
        ge=1,
        le=600,
        description="time step at which sights are computed and sensors tasked [s]",
    )
    cameras: tuple[StudyCamera, ...] = Field(min_length=1, max_length=MOST_SENSORS)
    sensors: tuple[StudySensor, ...] = Field(min_length=1, max_length=MOST_SENSORS)
    catalogue: ObjectCatalogue
    tasking: Annotated[CuedTasking | SearchPattern, Field(discriminator="kind")]
    detection: StudyDetection = StudyDetection()
    custody_h: float = Field(
        24.0, gt=0, description="time that an object stays in custody after each detection [h]"
    )
    axes: tuple[Axis, ...] = Field(
        (), max_length=8, description="fields of the study that are varied, and their values"
    )
    design: DesignWish = Grid(kind="grid")

    seeds: int = Field(
        1, ge=1, le=1000, description="number of seeds of each point: seed, seed + 1, ..."
    )

    @field_validator("axes", mode="before")
    @classmethod
    def _kind_may_be_omitted(cls, value: Any) -> Any:
        return axes_with_kinds(value)

    @model_validator(mode="after")
    def _names_fit(self) -> Study:
        cameras, sensors = [c.name for c in self.cameras], [s.name for s in self.sensors]
        for field, names in (("cameras", cameras), ("sensors", sensors)):
            if len(set(names)) < len(names):
                raise PydanticCustomError("names", "allowed: different names", {"field": field})
            if "range_km" in names:
                told = "allowed: other names than range_km, a column of its own"
                raise PydanticCustomError("names", "{told}", {"told": told, "field": field})
        for i, sensor in enumerate(self.sensors):
            if sensor.camera is not None and sensor.camera not in cameras:
                raise PydanticCustomError(
                    "camera",
                    "allowed: {names}",
                    {"names": ", ".join(cameras), "field": f"sensors.{i}.camera"},
                )
        return self

    @model_validator(mode="after")
    def _axes_fit(self) -> Study:
        check_fields(self.axes, FIXED)
        check_lengths(self.axes, self.design)
        return self

    @model_validator(mode="after")
    def _few_points(self) -> Study:
        if self.points > MOST_STUDY_POINTS:
            raise PydanticCustomError(
                "points", "allowed: up to {n} points", {"n": MOST_STUDY_POINTS, "field": "axes"}
            )
        frames = min(c.exposure.frames for c in self.cameras)
        if self.detection.frames_needed > frames:
            raise PydanticCustomError(
                "frames",
                "allowed: up to the frames of a dwell, {n}",
                {"n": frames, "field": "detection.frames_needed"},
            )
        return self

    @property
    def points(self) -> int:
        """How many points the axes make, seeds counted; 1 without any."""
        return points_of(self.axes, self.design, self.seeds)

    @property
    def is_varied(self) -> bool:
        """Whether it has points, be it one: of axes, or of seeds."""
        return bool(self.axes) or self.seeds > 1

    def camera_of(self, sensor: StudySensor) -> StudyCamera:
        """The camera of a sensor."""
        return next((c for c in self.cameras if c.name == sensor.camera), self.cameras[0])

    def as_dict(self) -> JsonObject:
        """The study with all defaults filled in, as plain data."""
        return self.model_dump(mode="json", by_alias=True)
