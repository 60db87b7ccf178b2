"""A scene with the content of its files in place of their names."""

from __future__ import annotations

from pipeline.inputs.band.curves import solar_spectrum
from pipeline.inputs.band.response import gather_response
from pipeline.inputs.earth_orientation import with_pole
from pipeline.inputs.pointing_tables import gather_pointing
from pipeline.inputs.sensor.distortion import gather_distortion
from pipeline.inputs.targets.ephemerides import Span, gather_ephemerides
from pipeline.plan.bodies.albedos import has_band_albedos, with_band_albedos
from pipeline.spec.pointing.observer import GroundObserver
from pipeline.spec.scene import Scene


def read_files(scene: Scene, also_s: Span | None = None) -> Scene:
    """The scene with what its files of orbits, pointing, distortion and meshes say, albedos over
    the band, and the wavelength that the air above its site bends.

    also_s : which times orbits are to cover beside the exposures

    Raises BadInput for a file that cannot be used.
    """
    for step in STEPS:
        scene = gather_ephemerides(scene, also_s) if step is gather_ephemerides else step(scene)
    return scene


def with_numbers(scene: Scene) -> Scene:
    """The scene with numbers for tables of reflectance."""
    if not has_band_albedos(scene):
        return scene
    wavelength, irradiance, *_ = solar_spectrum()
    return with_band_albedos(scene, wavelength, irradiance, gather_response(scene)[0])


def has_air(scene: Scene) -> bool:
    """Whether there is air above the scene's site."""
    o = scene.observer
    return isinstance(o, GroundObserver) and o.atmosphere is not None


def _with_meshes(scene: Scene) -> Scene:
    if not any(target.body.kind == "mesh" for target in scene.targets):
        return scene
    from pipeline.inputs.targets.meshes import gather_meshes  # an optional extra: trimesh

    return gather_meshes(scene)


def _with_wavelength(scene: Scene) -> Scene:
    if not has_air(scene):
        return scene
    from pipeline.inputs.sky.air import with_wavelength

    return with_wavelength(scene, gather_response(scene)[0])


# Each needs those before it.
STEPS = (
    with_pole,
    gather_distortion,
    gather_ephemerides,
    gather_pointing,
    with_numbers,
    _with_meshes,
    _with_wavelength,
)
