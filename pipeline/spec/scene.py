"""The scene: everything that a product is made from."""

from __future__ import annotations

from collections import Counter
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from pipeline.spec.accept import ACCEPTABLE, Accepted
from pipeline.spec.pointing.dwell import Cadence_s, Dwells
from pipeline.spec.pointing.observer import GroundObserver, Observer
from pipeline.spec.pointing.pointing import Pointing, TargetPointing
from pipeline.spec.sensor.cosmic_rays import CosmicRays
from pipeline.spec.sensor.sensor import Sensor
from pipeline.spec.sky.background import Background
from pipeline.spec.strict import MAX_PATH, FilePath, Strict
from pipeline.spec.targets.body import Body, Lighting
from pipeline.spec.targets.mesh import MeshBody
from pipeline.spec.targets.orbit import Orbit
from pipeline.spec.targets.population import MOST_POPULATIONS, Population

SCHEMA = "nightglass/scene/1"
LAYERS = (
    "dn",
    "mean_e",
    "stars_e",
    "targets_e",
    "background_e",
    "dark_e",
    "cosmic_rays_e",
    "lag_e",
    "calibrated_e",
)
USUAL_FRACTION = 0.05  # of its noise that a pixel may err by where a scene says nothing else
HIGHEST_BELOW_AIRGLOW_M = 50_000  # its layer is at 90 km: up to here it errs by its own 50%
CELL_PX = 256  # the fixed unit of the focal plane: tiles are unions of whole cells
MAX_CATALOGUES = 8
MOST_TARGETS = 100_000

CatalogueList = Annotated[tuple[FilePath, ...], Field(min_length=1, max_length=MAX_CATALOGUES)]


class Accuracy(Strict):
    """How much error all approximations together may make.

    noise_fraction : largest error of a pixel, in units of its noise sigma
    noise_floor_e : plan as for a pixel of this noise where the scene's least noise is larger, so
        that scenes whose detectors differ are drawn alike (sweeps set it)
    flux_fraction : largest relative error of each source's light, summed over the frame; of sources
        off the frame at least those are drawn whose light reaches it at the default
    check_cells : number of small windows that the reference method draws again, to compare; 0: no
        check of the achieved error
    """

    noise_fraction: float = Field(USUAL_FRACTION, gt=0, le=1)
    flux_fraction: float = Field(1e-3, gt=0, le=0.1)
    noise_floor_e: Annotated[float, Field(gt=0, le=1e12)] | None = None
    check_cells: int = Field(3, ge=0, le=1000)


class Exposure(Strict):
    """Integration time and the frames of one dwell; frame k starts at epoch + k cadence."""

    integration_s: float = Field(
        ge=0, le=1e5, description="exposure time [s]; 0: bias frames, without any light"
    )
    frames: int = Field(1, ge=1, le=100_000)
    cadence_s: Cadence_s | None = Field(
        None, description="time from frame to frame [s]; default: the integration time"
    )

    @model_validator(mode="after")
    def _cadence_holds_exposure(self) -> Exposure:
        if self.integration_s == 0 and self.frames > 1 and self.cadence_s is None:
            raise PydanticCustomError(
                "cadence", "allowed: a time above 0, as integration_s is 0", {"field": "cadence_s"}
            )
        if self.cadence_s is not None and self.cadence_s < self.integration_s:
            raise PydanticCustomError(
                "cadence",
                "allowed: at least integration_s = {t}",
                {"t": self.integration_s, "field": "cadence_s"},
            )
        return self

    @property
    def step_s(self) -> float:
        return self.cadence_s if self.cadence_s is not None else self.integration_s


class Stars(Strict):
    """Stars of one catalogue, or of several in layers, and which effects move them."""

    catalogue: FilePath | CatalogueList = Field(
        description="path or URL of a catalogue; or a list: the main one, then layers over it, "
        "whose stars are drawn where no earlier one holds them"
    )
    faintest_g_mag: float | None = Field(
        None,
        ge=-30,
        le=30,
        description="`auto`: as the noise allows; absent: all stars",
        json_schema_extra={"anyOf": [{"type": "number"}, {"const": "auto"}, {"type": "null"}]},
    )
    limit_from_noise: bool = Field(False, description="what faintest_g_mag: auto stands for")
    colour_fit: FilePath | None = Field(
        None, description="file of `nightglass color-fit -o`; default: the stellar library's fit"
    )
    space_motion: bool = True
    parallax: bool = True
    aberration: bool = True
    deflection: bool = True

    @model_validator(mode="before")
    @classmethod
    def _limit_may_be_auto(cls, data: object) -> object:
        if isinstance(data, dict) and data.get("faintest_g_mag") == "auto":
            return {**data, "faintest_g_mag": None, "limit_from_noise": True}
        return data

    @model_validator(mode="after")
    def _one_limit(self) -> Stars:
        if self.limit_from_noise and self.faintest_g_mag is not None:
            raise PydanticCustomError(
                "limit",
                "allowed: auto, or a number without limit_from_noise",
                {"field": "faintest_g_mag"},
            )
        return self

    @field_validator("catalogue", mode="before")
    @classmethod
    def _catalogues_differ(cls, value: object) -> object:
        """Names the place in the list of the first mistake; a list of one is that one."""
        paths = [value] if isinstance(value, str) else value
        if not isinstance(paths, list | tuple) or not 1 <= len(paths) <= MAX_CATALOGUES:
            raise PydanticCustomError(
                "catalogues",
                "allowed: a path or URL, or a list of 1 to {most} of them",
                {"most": MAX_CATALOGUES},
            )
        seen: list[str] = []
        for i, path in enumerate(paths):
            where = {} if isinstance(value, str) else {"index": i}
            if not isinstance(path, str) or not 1 <= len(path.strip()) <= MAX_PATH:
                raise PydanticCustomError(
                    "catalogue",
                    "allowed: text of 1 to {most} characters",
                    {"most": MAX_PATH} | where,
                )
            if path.strip() in seen:
                raise PydanticCustomError("catalogue", "allowed: each catalogue once", where)
            seen.append(path.strip())
        return seen[0] if len(seen) == 1 else seen

    @property
    def catalogues(self) -> tuple[str, ...]:
        """Paths of all catalogues: the main one, then the layers over it."""
        return (self.catalogue,) if isinstance(self.catalogue, str) else self.catalogue


class Target(Strict):
    """One resident space object."""

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")
    object_name: str | None = Field(
        None,
        min_length=1,
        max_length=80,
        description="what a catalogue calls it, for truth and labels; of populations as their file "
        "has it; default: the name",
    )
    orbit: Orbit
    body: Annotated[Body | MeshBody, Field(discriminator="kind")]
    lighting: Lighting | None = Field(
        None, description="how sunlight reaches it; default: direct sunlight, round Earth"
    )
    eclipse: bool = Field(True, description="dim it in the Earth's shadow")


class Output(Strict):
    """What is kept, and how."""

    layers: tuple[Literal[LAYERS], ...] = Field(("dn",), min_length=1)  # type: ignore[valid-type]
    tile_shape: tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(ge=1)]] | None = Field(
        None, description=f"a multiple of {CELL_PX} px on each axis, or the whole axis"
    )
    compression: Literal["blosc-zstd", "zstd", "none"] = "blosc-zstd"

    @model_validator(mode="after")
    def _layers_differ(self) -> Output:
        if len(set(self.layers)) != len(self.layers):
            raise PydanticCustomError("layers", "allowed: each layer once", {"field": "layers"})
        return self


class Scene(Strict):
    """A scene file, version 1."""

    schema_: Literal["nightglass/scene/1"] = Field(alias="schema")
    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,127}$")
    epoch: str = Field(max_length=40, description="UTC of the start of the first exposure")
    seed: int = Field(0, ge=0, lt=2**63)
    accuracy: Accuracy = Accuracy()
    accept: tuple[Accepted, ...] = Field(
        (),
        max_length=len(ACCEPTABLE),
        description="what is drawn though the frame is wrong there, and said first in the product: "
        + "; ".join(f"{word}: {what}" for word, what in ACCEPTABLE.items()),
    )
    observer: Observer
    sensor: Sensor
    pointing: Pointing
    exposure: Exposure
    dwells: Dwells | None = Field(
        None, description="dwells, one after the other; default: one, by pointing and exposure"
    )
    stars: Stars | None = None
    targets: tuple[Target, ...] = Field((), max_length=MOST_TARGETS)
    populations: tuple[Population, ...] = Field((), max_length=MOST_POPULATIONS)
    background: Background | None = None
    cosmic_rays: CosmicRays | None = None
    output: Output = Output()

    @model_validator(mode="after")
    def _targets_differ_in_name(self) -> Scene:
        names = [t.name for t in self.targets]
        twice = sorted(name for name, times in Counter(names).items() if times > 1)
        if twice:
            raise PydanticCustomError(
                "names",
                "allowed: different names; twice: {twice}",
                {"twice": ", ".join(twice[:10]), "field": "targets"},
            )
        return self

    @model_validator(mode="after")
    def _targets_are_known(self) -> Scene:
        names = [t.name for t in self.targets]
        pointings = {"pointing": self.pointing} | {
            f"dwells.{i}.pointing": d.pointing for i, d in enumerate(self.dwells or ())
        }
        for field, pointing in pointings.items():
            if isinstance(pointing, TargetPointing) and pointing.target not in names:
                shown = ", ".join(names[:10]) or "(there is none)"
                raise PydanticCustomError(
                    "target",
                    "allowed: the name of a target: {names}",
                    {"names": shown, "field": f"{field}.target"},
                )
        return self

    @model_validator(mode="after")
    def _air_is_above_a_site(self) -> Scene:
        b, o = self.background, self.observer
        if b is None or not b.of_the_air:
            return self
        names = [n for n in ("airglow", "moonlight", "twilight") if getattr(b, n)]
        request = {"field": f"background.{names[0]}"}
        if not isinstance(o, GroundObserver):
            raise PydanticCustomError(
                "air", "allowed: with an observer of kind ground, below the air", request
            )
        if b.airglow and o.height_m > HIGHEST_BELOW_AIRGLOW_M:
            raise PydanticCustomError(
                "air",
                "allowed: at a site up to {most} m high, below the air that glows",
                {"most": HIGHEST_BELOW_AIRGLOW_M, "field": "background.airglow"},
            )
        if names != ["airglow"] and not (o.atmosphere and o.atmosphere.extinction):
            request["field"] = f"background.{names[-1]}"
            raise PydanticCustomError(
                "air", "allowed: with observer.atmosphere.extinction, which scatters it", request
            )
        return self

    @model_validator(mode="after")
    def _tiles_hold_whole_cells(self) -> Scene:
        detector = self.sensor.detector
        if self.output.tile_shape is not None:
            rows = self.sensor.shape[0]
            if detector and detector.whole_columns and self.output.tile_shape[0] != rows:
                raise PydanticCustomError(
                    "tile",
                    "allowed: all {rows} rows, as charge runs along whole columns",
                    {"rows": rows, "field": "output.tile_shape"},
                )
            axes = zip(self.output.tile_shape, self.sensor.shape, ("rows", "columns"), strict=True)
            for tile, full, axis in axes:
                if tile != full and (tile % CELL_PX or tile > full):
                    allowed = f"on each axis a multiple of {CELL_PX} px up to {full}, or {full}"
                    if full <= CELL_PX:
                        allowed = f"all {full} {axis}"
                    raise PydanticCustomError(
                        "tile",
                        "allowed: {allowed}",
                        {"allowed": allowed, "field": "output.tile_shape"},
                    )
        return self

    @property
    def star_effects(self) -> dict[str, bool]:
        """Which effects turn directions: those asked for of the stars, all without stars."""
        stars = self.stars
        return {
            "deflection": stars is None or stars.deflection,
            "aberration": stars is None or stars.aberration,
        }

    def as_dict(self) -> dict:
        """The scene with all defaults filled in, as plain data."""
        return self.model_dump(mode="json", by_alias=True)
