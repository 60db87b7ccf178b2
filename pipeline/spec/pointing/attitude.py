"""How a pointing is not held: drift, jitter spectra, and flexible modes of the body."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal, Self, TypeVar

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from pipeline.spec.strict import FilePath, Strict

MOST_POINTS = 5000  # of a spectrum that a scene holds itself
MOST_PARTS, MOST_STATES = 50, 40
Rate = Annotated[float, Field(ge=-1e6, le=1e6)]
Arcsec = Annotated[float, Field(ge=0, le=1e6)]
Hertz = Annotated[float, Field(ge=1e-9, le=1e7)]
Seconds = Annotated[float, Field(ge=1e-9, le=1e9)]
Axis = Literal["x", "y", "roll"]
Points = Field(min_length=2, max_length=MOST_POINTS)
Density = Annotated[float, Field(ge=0, le=1e20)]
Row = Annotated[tuple[float, ...], Field(min_length=1, max_length=MOST_STATES)]
Matrix = Annotated[tuple[Row, ...], Field(min_length=1, max_length=MOST_STATES)]


class Drift(Strict):
    """Constant motion of the boresight in the camera's own axes, from the dwell's start on."""

    x_arcsec_s: Rate = Field(0.0, description="towards +x (columns)")
    y_arcsec_s: Rate = Field(0.0, description="towards +y (rows)")
    roll_arcsec_s: Rate = Field(0.0, description="from +x towards +y")


class WhiteJitter(Strict):
    """The same power at all frequencies of a band."""

    kind: Literal["white"]
    rms_arcsec: Arcsec
    low_hz: Hertz
    high_hz: Hertz

    @model_validator(mode="after")
    def _rising(self) -> WhiteJitter:
        return _rising(self)


class PowerLawJitter(Strict):
    """Power that falls as 1/f^exponent over a band; 1 is flicker noise."""

    kind: Literal["power_law"]
    rms_arcsec: Arcsec
    exponent: float = Field(1.0, ge=-4, le=8)
    low_hz: Hertz
    high_hz: Hertz

    @model_validator(mode="after")
    def _rising(self) -> PowerLawJitter:
        return _rising(self)


class ResonanceJitter(Strict):
    """A damped mode driven by white noise; all of its power counts to `rms_arcsec`."""

    kind: Literal["resonance"]
    rms_arcsec: Arcsec
    frequency_hz: Hertz
    damping: float = Field(ge=1e-6, le=10, description="damping ratio zeta; 1 is critical")


class TableJitter(Strict):
    """A measured one-sided spectrum; power laws between its points, nothing outside of them."""

    kind: Literal["table"]
    path: FilePath | None = Field(None, description="CSV: frequency_hz, arcsec2_per_hz")
    frequency_hz: Annotated[tuple[Hertz, ...], Points] | None = None
    arcsec2_per_hz: Annotated[tuple[Density, ...], Points] | None = None

    @model_validator(mode="after")
    def _a_file_or_a_table(self) -> TableJitter:
        f, s = self.frequency_hz, self.arcsec2_per_hz
        if (self.path is None) == (f is None) or (f is None) != (s is None):
            raise PydanticCustomError(
                "table", "allowed: path, or frequency_hz with arcsec2_per_hz", {"field": "path"}
            )
        if f is not None and s is not None:
            if len(f) != len(s):
                raise PydanticCustomError(
                    "lengths",
                    "allowed: as many values as frequency_hz has, {n}",
                    {"n": len(f), "field": "arcsec2_per_hz"},
                )
            if any(b <= a for a, b in pairwise(f)):
                raise PydanticCustomError(
                    "order", "allowed: increasing frequencies", {"field": "frequency_hz"}
                )
        return self


Jitter = Annotated[
    WhiteJitter | PowerLawJitter | ResonanceJitter | TableJitter, Field(discriminator="kind")
]


Banded = TypeVar("Banded", WhiteJitter, PowerLawJitter)
Model = TypeVar("Model", bound=Strict)


def _rising(part: Banded) -> Banded:
    if not part.high_hz > part.low_hz:
        raise PydanticCustomError(
            "band", "allowed: above low_hz = {low}", {"low": part.low_hz, "field": "high_hz"}
        )
    return part


def _one_strength(model: Model, *names: str) -> Model:
    given = [name for name in names if getattr(model, name) is not None]
    if len(given) != 1:
        raise PydanticCustomError(
            "one_of",
            "allowed: exactly one of {names}",
            {"names": ", ".join(names), "field": names[0]},
        )
    return model


class OscillatorMode(Strict):
    """A flexible mode: x'' + 2 zeta w x' + w^2 x = white noise."""

    kind: Literal["oscillator"]
    axis: Axis
    frequency_hz: Hertz
    damping: float = Field(ge=1e-6, le=1e3, description="zeta, of critical")
    rms_arcsec: Arcsec | None = None
    noise_arcsec_s2_rthz: Density | None = Field(
        None, description="two-sided density of the acceleration noise"
    )

    @model_validator(mode="after")
    def _strength(self) -> Self:
        return _one_strength(self, "rms_arcsec", "noise_arcsec_s2_rthz")


class MarkovMode(Strict):
    """A first-order Markov process: x' = -x / tau + white noise."""

    kind: Literal["markov"]
    axis: Axis
    time_constant_s: Seconds
    rms_arcsec: Arcsec | None = None
    noise_arcsec_s_rthz: Density | None = Field(
        None, description="two-sided density of the rate noise"
    )

    @model_validator(mode="after")
    def _strength(self) -> Self:
        return _one_strength(self, "rms_arcsec", "noise_arcsec_s_rthz")


class RandomWalkMode(Strict):
    """A gyro's angle random walk: it starts at zero at the epoch and has no bound."""

    kind: Literal["random_walk"]
    axis: Axis
    arcsec_rts: Arcsec = Field(description="arcsec per square root of a second")


class RateMarkovMode(Strict):
    """A rate that is a first-order Markov process (a gyro's bias); the angle is its integral."""

    kind: Literal["rate_markov"]
    axis: Axis
    time_constant_s: Seconds
    rms_arcsec_s: Arcsec


class SystemMode(Strict):
    """Any linear system dx = A x dt + B dw with unit white noise; C x moves x, y, roll [arcsec]."""

    kind: Literal["system"]
    a: Matrix
    b: Matrix
    c: Matrix

    @model_validator(mode="after")
    def _shapes(self) -> SystemMode:
        n = len(self.a)
        for name, rows, columns in (("a", n, n), ("b", n, len(self.b[0])), ("c", 3, n)):
            table = getattr(self, name)
            if len(table) != rows or any(len(row) != columns for row in table):
                raise PydanticCustomError(
                    "shape",
                    "allowed: {rows} rows of {columns} numbers",
                    {"rows": rows, "columns": columns, "field": name},
                )
        return self


Mode = Annotated[
    OscillatorMode | MarkovMode | RandomWalkMode | RateMarkovMode | SystemMode,
    Field(discriminator="kind"),
]


class AttitudeModel(Strict):
    """What moves the boresight besides what the pointing asks for; each part adds to the others.

    drift : steady rotation in the camera's axes; modes : flexible modes of the spacecraft or mount
    jitter : spectra that x and y have alike, each with its own random draws
    """

    drift: Drift | None = None
    jitter: Annotated[tuple[Jitter, ...], Field(max_length=MOST_PARTS)] = ()
    modes: Annotated[tuple[Mode, ...], Field(max_length=MOST_PARTS)] = ()

    @property
    def random(self) -> bool:
        return bool(self.jitter or self.modes)
