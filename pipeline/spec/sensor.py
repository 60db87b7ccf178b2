"""The sensor: optics, bandpass, point-spread function, detector and its noise."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from pipeline.spec.strict import Fraction, Positive, Strict

ImagePath = Annotated[str, Field(min_length=1, max_length=1024)]
NumberOrImage = float | ImagePath


class BoxBand(Strict):
    """All light between two wavelengths."""

    kind: Literal["box"]
    short_nm: float = Field(ge=100, le=30_000)
    long_nm: float = Field(ge=100, le=30_000)

    @model_validator(mode="after")
    def _ordered(self) -> BoxBand:
        if self.long_nm <= self.short_nm:
            raise PydanticCustomError(
                "order",
                "allowed: greater than short_nm = {short}",
                {"short": self.short_nm, "field": "long_nm"},
            )
        return self


class NamedBand(Strict):
    """A published filter by its speclite name, such as `bessell-V` or `gaiadr2-G`."""

    kind: Literal["named"]
    name: str = Field(max_length=80)


class TableBand(Strict):
    """A CSV file of two columns, wavelength_nm and transmission."""

    kind: Literal["table"]
    path: ImagePath


Bandpass = Annotated[BoxBand | NamedBand | TableBand, Field(discriminator="kind")]


class PsfShape(Strict):
    """What every point-spread function may have besides its optics."""

    oversampling: Literal[8, 16, 32, 64, 128] = Field(
        32, description="sub-pixel phases per pixel and axis"
    )
    jitter_px: float = Field(0.0, ge=0, le=50, description="rms of fast pointing jitter per axis")
    charge_diffusion_px: float = Field(
        0.0, ge=0, le=50, description="rms of charge diffusion per axis"
    )


class GaussianPsf(PsfShape):
    """A Gaussian; sigma_px is its standard deviation on each axis, before the pixel."""

    kind: Literal["gaussian"]
    sigma_px: float = Field(ge=0.05, le=50)


class AiryPsf(PsfShape):
    """Diffraction by the entrance pupil with its central obscuration, at one wavelength."""

    kind: Literal["airy"]
    wavelength_nm: Positive | None = Field(
        None, description="default: the mean wavelength of the sensor's response"
    )


Psf = Annotated[GaussianPsf | AiryPsf, Field(discriminator="kind")]


class Sensor(Strict):
    """A telescope and its focal plane. Array axes are (rows, columns)."""

    shape: tuple[Annotated[int, Field(ge=1, le=60_000)], Annotated[int, Field(ge=1, le=60_000)]]
    pixel_pitch_um: float = Field(ge=0.05, le=1000)
    focal_length_m: float = Field(ge=1e-3, le=1000)
    aperture_m: float = Field(ge=1e-4, le=100)
    obscuration: float = Field(0.0, ge=0, lt=1, description="linear: inner over outer diameter")
    fill_factor: float = Field(1.0, gt=0, le=1)
    bandpass: Bandpass
    transmission: Fraction | ImagePath = 1.0
    quantum_efficiency: Fraction | ImagePath = 1.0
    psf: Psf
    full_well_e: Annotated[float, Field(gt=0, le=1e18)] | None = None
    gain_e_per_dn: Annotated[float, Field(ge=1e-9, le=1e12)] | ImagePath = 1.0
    adc_bits: int = Field(16, ge=1, le=63)
    adc_rounding: Literal["half_even", "floor"] = "half_even"
    bias_dn: Annotated[float, Field(ge=-1e18, le=1e19)] | ImagePath = 0.0
    flat: Annotated[float, Field(ge=0, le=1e3)] | ImagePath = 1.0
    dark_e_per_s: Annotated[float, Field(ge=0, le=1e12)] | ImagePath = 0.0
    read_noise_e: Annotated[float, Field(ge=0, le=1e9)] | ImagePath = 0.0
    photon_noise: bool = True
