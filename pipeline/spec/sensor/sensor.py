"""The sensor: optics, bandpass, point-spread function, detector and its noise."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from pipeline.spec.sensor.detector import Detector, check_detector
from pipeline.spec.sensor.distortion import Distortion
from pipeline.spec.strict import FilePath, Positive, Strict

NumberOrImage = float | FilePath


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
    path: FilePath


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
    charge_diffusion_um: float | None = Field(
        None, ge=0, le=1000, description="the same as a length; instead of charge_diffusion_px"
    )

    @model_validator(mode="after")
    def _one_diffusion(self) -> PsfShape:
        if self.charge_diffusion_um is not None and self.charge_diffusion_px:
            raise _error("charge_diffusion_um", "allowed: instead of charge_diffusion_px")
        return self

    def diffusion_px(self, pixel_pitch_um: float) -> float:
        """rms of charge diffusion per axis [px]."""
        if self.charge_diffusion_um is None:
            return self.charge_diffusion_px
        return self.charge_diffusion_um / pixel_pitch_um


def _error(field: str, allowed: str) -> PydanticCustomError:
    """What is wrong between two fields, told of one of them."""
    return PydanticCustomError("combination", "{allowed}", {"field": field, "allowed": allowed})


class GaussianPsf(PsfShape):
    """A Gaussian; sigma_px is its standard deviation on each axis, before the pixel."""

    kind: Literal["gaussian"]
    sigma_px: float = Field(ge=0.05, le=50)
    sigma_minor_px: float | None = Field(
        None,
        ge=0.05,
        le=50,
        description="sigma of the narrower axis [px]; sigma_px is then the wider one's",
    )
    angle_deg: float = Field(
        0.0,
        ge=-360,
        le=360,
        description="angle of the wider axis, from +x (columns) to +y (rows) [deg]",
    )

    @model_validator(mode="after")
    def _ordered(self) -> GaussianPsf:
        if self.sigma_minor_px is not None and self.sigma_minor_px > self.sigma_px:
            raise _error("sigma_minor_px", f"allowed: at most sigma_px = {self.sigma_px}")
        return self


class Chromatic(PsfShape):
    """What point-spread functions have whose size follows the wavelength."""

    wavelength_nm: Positive | None = Field(
        None, description="wavelength [nm]; default: the sensor's whole response"
    )
    wavelengths: int | None = Field(
        None,
        ge=1,
        le=640,
        description="wavelengths that stand for the response; default: as many as the accuracy "
        "asks for; 1: the mean alone",
    )

    @model_validator(mode="after")
    def _one_wavelength(self) -> Chromatic:
        if self.wavelength_nm is not None and (self.wavelengths or 1) > 1:
            raise _error("wavelengths", "allowed: 1, or none, with wavelength_nm")
        return self


class Vanes(Strict):
    """Straight vanes that hold the secondary mirror, from the centre to the rim, equally spread."""

    count: int = Field(ge=1, le=12)
    width_m: float = Field(gt=0, le=10)
    angle_deg: float = Field(
        0.0,
        ge=-360,
        le=360,
        description="angle of the first vane, from +x (columns) to +y (rows) [deg]",
    )


class Aberration(Strict):
    """A Zernike term in Noll's order, rms over the unobscured pupil; in nm or in waves.

    A wave is `wavelength_nm`, or the mean wavelength of the response. The path difference stays
    the same at all wavelengths. Tilts (2, 3) are not taken: they would move stars from the truth.
    """

    noll: int = Field(ge=4, le=66)
    rms_nm: float | None = Field(None, ge=-1e5, le=1e5)
    rms_waves: float | None = Field(None, ge=-50, le=50)

    @model_validator(mode="after")
    def _one_unit(self) -> Aberration:
        if (self.rms_nm is None) == (self.rms_waves is None):
            raise _error("rms_nm", "allowed: exactly one of rms_nm and rms_waves")
        return self


class AiryPsf(Chromatic):
    """Diffraction by the entrance pupil: obscuration, vanes, defocus and Zernike terms."""

    kind: Literal["airy"]
    vanes: Vanes | None = None
    aberrations: tuple[Aberration, ...] = Field((), max_length=63)
    defocus_um: float = Field(
        0.0, ge=-1e5, le=1e5, description="displacement of the detector from best focus [um]"
    )

    @model_validator(mode="after")
    def _terms_once(self) -> AiryPsf:
        orders = [a.noll for a in self.aberrations]
        if len(set(orders)) < len(orders):
            raise _error("aberrations", "allowed: each Noll index once")
        return self


FWHM_PX = 0.1, 100  # least and largest of a moffat, however it is given


class MoffatPsf(PsfShape):
    """A Moffat profile of the light on the detector, all causes together; one width."""

    kind: Literal["moffat"]
    beta: float = Field(4.765, ge=1.5, le=50, description="4.765 has the wings of turbulence")
    fwhm_px: float | None = Field(None, ge=FWHM_PX[0], le=FWHM_PX[1])
    fwhm_arcsec: float | None = Field(None, gt=0, le=100)

    @model_validator(mode="after")
    def _one_width(self) -> MoffatPsf:
        if (self.fwhm_px is None) == (self.fwhm_arcsec is None):
            raise _error("fwhm_px", "allowed: exactly one of fwhm_px and fwhm_arcsec")
        return self


class KolmogorovPsf(Chromatic):
    """Long-exposure seeing along the line of sight, and diffraction by the aperture unless off."""

    kind: Literal["kolmogorov"]
    fwhm_arcsec: float | None = Field(
        None, ge=0.01, le=100, description="seeing: full width at half maximum, air alone [arcsec]"
    )
    r0_m: float | None = Field(None, ge=1e-3, le=10, description="Fried's parameter")
    reference_nm: float = Field(
        500.0, ge=100, le=30_000, description="wavelength that fwhm_arcsec or r0_m is given for"
    )
    outer_scale_m: float | None = Field(
        None,
        ge=0.1,
        le=1e5,
        description="size of the largest eddies (von Karman); fwhm_arcsec or r0_m stay those of "
        "turbulence without one, and the image is narrower; default: no end",
    )
    diffraction: bool = True

    @model_validator(mode="after")
    def _one_seeing(self) -> KolmogorovPsf:
        if (self.fwhm_arcsec is None) == (self.r0_m is None):
            raise _error("fwhm_arcsec", "allowed: exactly one of fwhm_arcsec and r0_m")
        return self


Place = Annotated[float, Field(ge=0, le=1e5)]


class TablePsf(PsfShape):
    """An image of the light: .npy, .fits, or a listing of OpticStudio (FFT, Huygens) or CODE V."""

    kind: Literal["table"]
    path: FilePath
    samples_per_px: float | None = Field(None, ge=0.25, le=256)
    sample_um: float | None = Field(None, gt=0, le=1000, description="instead of samples_per_px")
    centre: Literal["file", "middle", "sample", "peak", "centroid"] | tuple[Place, Place] | None = (
        Field(
            None,
            description="where the source stands; [row, column] counts from 0; an image with an "
            "even side must say it",
        )
    )
    includes_pixel: bool = Field(
        False, description="the light was collected by pixels already: no pixel is applied again"
    )
    light_fraction: float = Field(
        1.0,
        gt=0,
        le=1,
        description="fraction of the source's light within the table; the rest is lost",
    )
    flip_y: bool = Field(False, description="the first row listed is the one of the largest y")

    @model_validator(mode="after")
    def _one_spacing(self) -> TablePsf:
        if self.samples_per_px is not None and self.sample_um is not None:
            raise _error("sample_um", "allowed: one of sample_um and samples_per_px")
        return self


KindOfPsf = GaussianPsf | AiryPsf | MoffatPsf | KolmogorovPsf | TablePsf
OnePsf = Annotated[KindOfPsf, Field(discriminator="kind")]
FramePlaces = Annotated[
    tuple[Annotated[float, Field(ge=-1e5, le=1e5)], ...], Field(min_length=1, max_length=9)
]


class FieldPsf(Strict):
    """Point-spread functions at a grid of places in the frame, and their mixtures between them.

    A star's light is shared, bilinearly, among the four places around it; outside of the grid the
    nearest place counts. A rotated or displaced image is no mixture: give places enough for it.
    """

    kind: Literal["field"]
    rows_px: FramePlaces = Field(description="increasing; pixel 0 is the centre of the first")
    columns_px: FramePlaces
    psfs: tuple[tuple[OnePsf, ...], ...] = Field(
        min_length=1, max_length=9, description="psfs[i][j] is that of rows_px[i], columns_px[j]"
    )

    @model_validator(mode="after")
    def _grid(self) -> FieldPsf:
        for name in ("rows_px", "columns_px"):
            places = getattr(self, name)
            if any(b < a + 1.0 for a, b in pairwise(places)):
                raise _error(name, "allowed: increasing places, at least 1 px apart")
        rows, columns = len(self.rows_px), len(self.columns_px)
        if len(self.psfs) != rows or any(len(row) != columns for row in self.psfs):
            allowed = f"allowed: a row for each of {rows} rows_px, one for each of {columns} "
            raise _error("psfs", f"{allowed}columns_px in it")
        return self

    @model_validator(mode="after")
    def _one_aperture(self) -> FieldPsf:
        every = [psf for row in self.psfs for psf in row]
        if len({isinstance(psf, TablePsf) and psf.includes_pixel for psf in every}) > 1:
            raise _error("psfs", "allowed: includes_pixel for all of them or for none")
        if len({getattr(psf, "vanes", None) for psf in every}) > 1:
            raise _error("psfs", "allowed: the same vanes for all of them: the aperture is one")
        return self

    def name_of(self, field: str, node: int) -> str:
        """A dotted field of a point-spread function as that of place `node`, row by row."""
        row, column = divmod(node, len(self.columns_px))
        return f"sensor.psf.psfs.{row}.{column}" + field.removeprefix("sensor.psf")


Psf = Annotated[KindOfPsf | FieldPsf, Field(discriminator="kind")]


Passed = Annotated[float, Field(gt=0, le=1)]


class Sensor(Strict):
    """A telescope and its focal plane. Array axes are (rows, columns)."""

    shape: tuple[Annotated[int, Field(ge=1, le=60_000)], Annotated[int, Field(ge=1, le=60_000)]]
    pixel_pitch_um: float = Field(ge=0.05, le=1000)
    focal_length_m: float = Field(ge=1e-3, le=1000)
    aperture_m: float = Field(ge=1e-4, le=100)
    obscuration: float = Field(0.0, ge=0, lt=1, description="linear: inner over outer diameter")
    fill_factor: float = Field(1.0, gt=0, le=1)
    bandpass: Bandpass
    transmission: Passed | FilePath = 1.0
    quantum_efficiency: Passed | FilePath = 1.0
    psf: Psf
    distortion: Distortion | None = None
    full_well_e: Annotated[float, Field(gt=0, le=1e18)] | None = None
    gain_e_per_dn: Annotated[float, Field(ge=1e-9, le=1e6)] | FilePath = 1.0
    adc_bits: int = Field(16, ge=1, le=63)
    adc_rounding: Literal["half_even", "floor"] = "half_even"
    bias_dn: Annotated[float, Field(ge=-1e19, le=2e19)] | FilePath = 0.0
    flat: Annotated[float, Field(ge=1e-6, le=1e3)] | FilePath = 1.0
    dark_e_per_s: Annotated[float, Field(ge=0, le=1e12)] | FilePath = 0.0
    dark_scale: float = Field(
        1.0, ge=1e-12, le=1e12, description="e-/s for each unit of the image in dark_e_per_s"
    )
    read_noise_e: Annotated[float, Field(ge=0, le=1e9)] | FilePath = 0.0
    photon_noise: bool = True
    pupil_projection: bool = Field(
        True,
        description="dim light by the cosine of its angle off axis, as the pupil is seen "
        "from there; default: not where flat is an image, as a measured flat holds it",
    )
    sun_exclusion_deg: float = Field(
        30.0,
        ge=0,
        le=180,
        description="angle from the boresight within which the Sun would show "
        "in a frame: refused where no stray light of it is drawn",
    )
    detector: Detector | None = Field(None, description="bad pixels, patterns, ways of reading out")

    @property
    def ifov_rad(self) -> float:
        """Angle that a pixel's pitch covers on the axis [rad]."""
        return self.pixel_pitch_um * 1e-6 / self.focal_length_m

    @property
    def every_psf(self) -> tuple[OnePsf, ...]:
        """The point-spread function, or those of all places of the field, row by row."""
        if isinstance(self.psf, FieldPsf):
            return tuple(one for row in self.psf.psfs for one in row)
        return (self.psf,)

    @model_validator(mode="before")
    @classmethod
    def _pupil_unless_in_the_flat(cls, data: object) -> object:
        """A measured flat holds the projected pupil: an image switches it off unless asked for."""
        if not isinstance(data, dict) or data.get("pupil_projection") is not None:
            return data
        return data | {"pupil_projection": not isinstance(data.get("flat"), str)}

    @model_validator(mode="after")
    def _bias_is_within_reach(self) -> Sensor:
        if isinstance(self.bias_dn, str) or -(2**self.adc_bits) <= self.bias_dn <= self.top_dn:
            return self
        allowed = f"allowed: {-(2**self.adc_bits)} to {self.top_dn} with adc_bits {self.adc_bits}"
        raise _error("bias_dn", f"{allowed}: beyond it no light could be read")

    @property
    def top_dn(self) -> int:
        """Largest bias: twice the converter's range, where every pixel of a frame is full."""
        return int(2 ** (self.adc_bits + 1))

    @model_validator(mode="after")
    def _scale_is_of_an_image(self) -> Sensor:
        if self.dark_scale != 1.0 and not isinstance(self.dark_e_per_s, str):
            raise _error("dark_scale", "allowed: 1, or any with an image in dark_e_per_s")
        return self

    @model_validator(mode="after")
    def _detector_fits(self) -> Sensor:
        check_detector(self)
        return self
