"""What can be said against a scene before it is planned: its times, its sky, the files it names."""

from __future__ import annotations

from pipeline.inputs.band.response import gather_response
from pipeline.inputs.earth_orientation import gather_dut1_s
from pipeline.inputs.sensor.psf_tables import gather_psf_table
from pipeline.inputs.sensor.sensor import LIMITS, gather_sensor_maps
from pipeline.physics.positions.times import parse_utc
from pipeline.plan.optics.optics import check_motion
from pipeline.plan.sky.doubts import accepted_skies
from pipeline.resolve.files import read_files
from pipeline.spec.load import path_holders
from pipeline.spec.scene import Scene


def judge(scene: Scene) -> None:
    """BadInput for what planning would refuse: times out of range, a boresight in the Earth, skies
    that are not accepted, files that are not what the scene says. No star is read.

    It takes milliseconds for a scene that names no file but its catalogues.
    """
    dut1_s, _ = gather_dut1_s(*parse_utc(scene.epoch))
    if any(isinstance(getattr(scene.sensor, name), str) for name in LIMITS) or _has_map(scene):
        gather_sensor_maps(scene)
    gather_response(scene)
    gather_psf_table(scene)
    scene = read_files(scene)
    check_motion(scene)
    accepted_skies(scene, dut1_s)


def _has_map(scene: Scene) -> bool:
    """Whether the detector names an image of its pixels."""
    return any(
        name.startswith("sensor.detector") and isinstance(holder.get(key), str)
        for name, holder, key in path_holders(scene.as_dict())
    )
