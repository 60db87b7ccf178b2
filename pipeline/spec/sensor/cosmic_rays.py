"""Cosmic rays: made by a physical generator, or taken from a library of recorded events."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from pipeline.spec.strict import FilePath, Strict

SPACE_RATE_PER_CM2_S = 5.0  # galactic cosmic rays far above the Earth, solar minimum
GROUND_RATE_PER_CM2_S = 1.0 / 60.0  # muons at sea level on a level surface
SPACE_HELIUM_SHARE = 0.09  # of primary cosmic rays (Glossary of Meteorology, AMS)
MUON_ZENITH_POWER = 2.0


class GeneratedCosmicRays(Strict):
    """Straight tracks of fast nuclei through the silicon.

    source : `space`, an isotropic flux with 9% helium; `ground`, muons about the zenith (cos^2),
        for a detector that faces it
    """

    kind: Literal["generated"]
    source: Literal["space", "ground"] = "space"
    rate_per_cm2_s: float | None = Field(
        None,
        ge=0,
        le=1e5,
        description="events per cm^2 and second; default: 5 in space, 1/60 at sea level",
    )
    thickness_um: float = Field(
        15.0, ge=0.5, le=2000, description="thickness of the silicon that collects charge [um]"
    )
    diffusion_um: float = Field(
        3.0, ge=0, le=100, description="rms per axis of charge from the side far of the electrodes"
    )
    helium_share: float | None = Field(
        None,
        ge=0,
        le=1,
        description="fraction of helium nuclei; default: 0.09 in space, 0 on the ground",
    )
    delta_electrons: bool = Field(
        True, description="electrons of 30 keV and more make tracks; else they are cut off there"
    )
    after_flat: bool = Field(
        False, description="true: the flat does not dim them (by default it does)"
    )


class LibraryCosmicRays(Strict):
    """Recorded events, at the recorded rate times `rate_scale`.

    arrival : `poisson`, a Poisson number of single events at random places; `frames`,
        whole recorded frames at their places, the centre cut out of larger ones and smaller
        ones tiled over the detector
    """

    kind: Literal["library"]
    path: FilePath
    rate_scale: float = Field(1.0, ge=0, le=1e6, description="relative to the recorded rate")
    arrival: Literal["poisson", "frames"] = "poisson"
    after_flat: bool = Field(
        False, description="true: the flat does not dim them (by default it does)"
    )


CosmicRays = Annotated[GeneratedCosmicRays | LibraryCosmicRays, Field(discriminator="kind")]
