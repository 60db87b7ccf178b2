"""What draws the cosmic rays of a scene: the generator, or a library of recorded ones."""

from __future__ import annotations

from pathlib import Path

from pipeline.errors import BadInput
from pipeline.physics.cosmic_rays.frame import CosmicRays, events_a_frame
from pipeline.physics.cosmic_rays.library import Recorded
from pipeline.physics.cosmic_rays.tracks import Flux
from pipeline.spec.sensor import cosmic_rays as spec
from pipeline.spec.sensor.sensor import Sensor

MOST_EVENTS = 2_000_000  # a frame: 130 MB of tracks


def gather_cosmic_rays(
    request: spec.CosmicRays | None, sensor: Sensor, integration_s: float
) -> CosmicRays | None:
    """What draws the cosmic rays of a scene; None where there are none (absent, or rate 0).

    BadInput where a library cannot be read, or lacks what the arrival asks for.
    """
    if request is None:
        return None
    if isinstance(request, spec.GeneratedCosmicRays):
        flux = _flux(request, sensor, integration_s)
        return flux and _few_enough("rate_per_cm2_s", flux.rate_per_cm2_s, flux)
    if request.rate_scale == 0.0:
        return None
    from pipeline.inputs.sensor.cosmic_ray_library import read_library

    library = read_library(Path(request.path))
    if request.arrival == "frames" and (library.shape is None or library.frames is None):
        allowed = "poisson: the library does not say which frame an event is of"
        raise BadInput("cosmic_rays.arrival", request.arrival, allowed)
    recorded = Recorded(
        library,
        *sensor.shape,
        sensor.pixel_pitch_um,
        integration_s,
        request.rate_scale,
        request.arrival,
    )
    return _few_enough("rate_scale", request.rate_scale, recorded)


def _flux(request: spec.GeneratedCosmicRays, sensor: Sensor, integration_s: float) -> Flux | None:
    """The particles that are generated, defaults filled in; None of rate 0."""
    defaults = (spec.GROUND_RATE_PER_CM2_S, 0.0, spec.MUON_ZENITH_POWER)
    if request.source == "space":
        defaults = (spec.SPACE_RATE_PER_CM2_S, spec.SPACE_HELIUM_SHARE, 0.0)
    rate = defaults[0] if request.rate_per_cm2_s is None else request.rate_per_cm2_s
    helium = defaults[1] if request.helium_share is None else request.helium_share
    if rate == 0.0:
        return None
    return Flux(
        *sensor.shape,
        sensor.pixel_pitch_um,
        request.thickness_um,
        rate,
        integration_s,
        defaults[2],
        helium,
        request.diffusion_um,
        request.delta_electrons,
    )


def _few_enough(key: str, value: float, rays: CosmicRays) -> CosmicRays:
    events = events_a_frame(rays)
    if events > MOST_EVENTS:
        allowed = f"at most {value * MOST_EVENTS / events:.3g} ({MOST_EVENTS:.0e} events a frame)"
        raise BadInput(f"cosmic_rays.{key}", value, allowed)
    return rays
