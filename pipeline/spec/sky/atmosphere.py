"""The air above a site: what it takes from starlight, and how it bends it."""

from __future__ import annotations

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from pipeline.spec.strict import Fraction, Strict


class Extinction(Strict):
    """How much light the air takes away, in magnitudes per unit of air mass.

    mag_per_airmass : one coefficient for the whole band; else a standard atmosphere over the band:
        Rayleigh scattering at the site's height, aerosols and ozone
    aerosol_mag : aerosol extinction at 550 nm and sea level [mag]
    aerosol_slope : exponent by which it falls with wavelength
    diffuse_share : fraction of it that dims zodiacal and galactic light: much of what is scattered
        out of a line of sight is scattered into it from around. A choice: published values for
        zodiacal light go from below 0 where it is faint to 0.7 (Noll et al. 2012, section 3.3)
    """

    mag_per_airmass: float | None = Field(None, ge=0, le=20)
    aerosol_mag: float = Field(0.12, ge=0, le=10)
    aerosol_slope: float = Field(1.3, ge=0, le=4)
    ozone_dobson: float = Field(300.0, ge=0, le=1000)
    diffuse_share: Fraction = 0.5

    @model_validator(mode="after")
    def _one_law(self) -> Extinction:
        """One coefficient leaves nothing to the standard atmosphere's parts."""
        for name in ("aerosol_mag", "aerosol_slope", "ozone_dobson"):
            usual = getattr(self, name) == type(self).model_fields[name].default
            if self.mag_per_airmass is not None and not usual:
                allowed = "allowed: without mag_per_airmass, which stands for all of the air"
                raise PydanticCustomError("combination", allowed, {"field": name})
        return self


class Refraction(Strict):
    """Bending by the air; pressure and temperature default to the standard atmosphere's.

    wavelength_nm : wavelength of the refraction; default: the mean of the sensor's response
    """

    pressure_hpa: float | None = Field(None, gt=0, le=1200)
    temperature_c: float | None = Field(None, ge=-90, le=60)
    humidity: Fraction = Field(0.3, description="relative, 0 to 1")
    wavelength_nm: float | None = Field(None, ge=200, le=20_000)


class Atmosphere(Strict):
    """Parts of the air that a site looks through; each omitted unless asked for."""

    extinction: Extinction | bool | None = Field(None, description="true, or how")
    refraction: Refraction | bool | None = Field(None, description="true, or how")

    @model_validator(mode="before")
    @classmethod
    def _switches(cls, data: object) -> object:
        """True stands for a part with its defaults, false for none: no field keeps a boolean."""
        if not isinstance(data, dict):
            return data
        meant: dict[bool, object] = {False: None, True: {}}
        return {k: meant[v] if isinstance(v, bool) else v for k, v in data.items()}

    @model_validator(mode="after")
    def _some_part(self) -> Atmosphere:
        if not (self.extinction or self.refraction):
            raise PydanticCustomError("parts", "allowed: extinction, refraction or both")
        return self
