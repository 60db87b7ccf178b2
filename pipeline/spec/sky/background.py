"""Light from the sky: zodiacal, the Galaxy's, of stars too faint to be drawn, and uniform."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from pipeline.spec.sky.stray_light import StrayLight
from pipeline.spec.strict import Strict

UNIFORM = ("uniform_mag_arcsec2", "uniform_e_per_s")


class Zodiacal(Strict):
    """Sunlight scattered by interplanetary dust, with the gegenschein.

    near_sun : what happens below 15 degrees from the Sun, where the published table ends: `refuse`
        the scene, or `extrapolate` by a power law down to 2 degrees
    """

    near_sun: Literal["refuse", "extrapolate"] = "refuse"


class Galactic(Strict):
    """Starlight scattered by interstellar dust, as a fraction of all light of the Milky Way."""

    share: float = Field(
        0.25, gt=0, le=0.5, description="that fraction: a choice within the published 0.2 to 0.3"
    )


class Airglow(Strict):
    """Light that the upper air itself sends, by a layer at 90 km.

    solar_flux_sfu : radio flux of the Sun at 10.7 cm, monthly mean, 1e-22 W/m2/Hz: 70 to 250
    """

    solar_flux_sfu: float = Field(130.0, ge=50, le=400)


class Background(Strict):
    """Light from the sky; the parts add up.

    starlight : light of the stars that are not drawn. `auto`: of the catalogue's stars beyond the
        limiting magnitude, where the program chose it; `all` or true: those, and beyond the
        catalogue's end the published star counts; `none` or false: omitted
    """

    zodiacal: Zodiacal | bool | None = Field(None, description="true, or how")
    galactic: Galactic | bool | None = Field(None, description="true, or how")
    starlight: Literal["auto", "all", "none"] | bool = "auto"
    stray_light: StrayLight | None = None
    airglow: Airglow | bool | None = Field(None, description="true, or how; sites on the ground")
    moonlight: Literal["yes"] | bool | None = Field(None, description="scattered by the air")
    twilight: Literal["yes"] | bool | None = Field(
        None, description="sunlight scattered by the air, the Sun below the horizon"
    )
    uniform_mag_arcsec2: float | None = Field(
        None, ge=-30, le=40, description="AB magnitude per square arcsecond in the sensor's band"
    )
    uniform_e_per_s: float | None = Field(
        None, ge=0, le=1e12, description="electrons per second and pixel"
    )

    @model_validator(mode="before")
    @classmethod
    def _switches(cls, data: object) -> object:
        """True stands for a part with its defaults, false for none: no field keeps a boolean."""
        if not isinstance(data, dict):
            return data
        meant = {
            "zodiacal": (None, {}),
            "galactic": (None, {}),
            "starlight": ("none", "all"),
            "airglow": (None, {}),
            "moonlight": (None, "yes"),
            "twilight": (None, "yes"),
        }
        return {
            k: meant[k][v] if k in meant and isinstance(v, bool) else v for k, v in data.items()
        }

    @model_validator(mode="after")
    def _some_part(self) -> Background:
        both = all(getattr(self, name) is not None for name in UNIFORM)
        if both or not self.model_fields_set:
            raise PydanticCustomError(
                "one_of",
                f"allowed: exactly one of {' and '.join(UNIFORM)}, or any of "
                f"{', '.join(_not_uniform())} and at most one of the two",
            )
        return self

    @property
    def varies(self) -> bool:
        """True where some part of it differs over the sky."""
        parts = [name for name in _not_uniform() if name != "starlight"]
        return any(getattr(self, name) for name in parts) or self.starlight == "all"

    @property
    def of_the_air(self) -> bool:
        """True where some part of it is light of the air above a site."""
        return any((self.airglow, self.moonlight, self.twilight))


def _not_uniform() -> list[str]:
    """Names of all parts but the uniform ones."""
    return [name for name in Background.model_fields if name not in UNIFORM]
