"""Orbits from files: what astropy, sgp4 and the tables themselves say; damaged files refused."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import GCRS, ITRS, TEME, CartesianDifferential, CartesianRepresentation
from astropy.coordinates.matrix_utilities import rotation_matrix
from astropy.time import Time
from astropy.utils import iers
from sgp4 import exporter
from sgp4.api import WGS72, Satrec

from pipeline.errors import BadInput
from pipeline.inputs.earth_orientation import gather_pole_arcsec
from pipeline.inputs.targets.ephemerides import gather_ephemerides, to_gcrs
from pipeline.inputs.targets.ephemeris_files import read_ephemeris
from pipeline.inputs.targets.omm_files import read_omm
from pipeline.physics.positions.orbit_table import best_nodes
from pipeline.physics.positions.orbit_two_body import two_body
from pipeline.physics.positions.times import instants, parse_utc
from pipeline.plan.bodies.orbits import orbit_states
from pipeline.plan.targets.bounds import table_error_m
from pipeline.spec.load import parse_scene
from pipeline.spec.targets.orbit import EphemerisOrbit, OmmOrbit, TableOrbit

SCENE: dict[str, Any] = {
    "schema": "nightglass/scene/1", "name": "files", "epoch": "2017-02-14T06:07:00Z",
    "observer": {"kind": "fixed", "position_au": [1, 0, 0]},
    "sensor": {
        "shape": [256, 256], "pixel_pitch_um": 9.0, "focal_length_m": 1.0, "aperture_m": 0.2,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 1.0},
    },
    "pointing": {"mode": "sidereal", "boresight_ra_deg": 10, "boresight_dec_deg": 20},
    "exposure": {"integration_s": 10.0, "frames": 6},
}  # fmt: skip
BODY = {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.2}
HEAD = "CCSDS_OEM_VERS = 2.0\nMETA_START\n"
LINES = (
    "1 25544U 98067A   19110.12345678  .00001000  00000-0  23000-4 0  9998",
    "2 25544  51.6400 100.0000 0002000  80.0000 280.0000 15.52000000166005",
)


def scene(orbit: dict[str, Any], epoch: str | None = None) -> Any:
    data = copy.deepcopy(SCENE)
    data["epoch"] = epoch or data["epoch"]
    data["targets"] = [{"name": "t", "orbit": orbit, "body": BODY}]
    return parse_scene(data)


def table(orbit: dict[str, Any], epoch: str | None = None) -> TableOrbit:
    found = gather_ephemerides(scene(orbit, epoch)).targets[0].orbit
    assert isinstance(found, TableOrbit)
    return found


def states(orbit: Any, offsets: np.ndarray, epoch: str = SCENE["epoch"]) -> Any:
    start = parse_utc(epoch)
    return orbit_states(orbit, "targets.0.orbit", start, offsets, instants(start, offsets))


def sp3(shared_data: Path) -> Path:
    return shared_data / "sp3" / "igs19362.sp3c"


def test_sp3_against_astropy(shared_data: Path) -> None:
    """Every kept row turned from ITRF with UT1 and the pole: within 1 cm of astropy's GCRS."""
    orbit = table({"kind": "ephemeris", "path": str(sp3(shared_data)), "object": "G05"})
    rows = np.array(orbit.rows)
    source = read_ephemeris(sp3(shared_data), None, orbit.epoch, "f")["G05"][0]
    gps = Time("2017-02-14T00:00:00", scale="tai") + 19 * u.s
    assert abs((Time(source.utc1[0], source.utc2[0], format="jd", scale="utc") - gps).sec) < 1e-9
    times = Time("2017-02-14T06:07:00", scale="utc") + rows[:, 0] * u.s
    keep = np.searchsorted(
        [(Time(a, b, format="jd", scale="utc") - times[0]).sec
         for a, b in zip(source.utc1, source.utc2, strict=True)], -1e-3
    )  # fmt: skip
    with iers.conf.set_temp("auto_download", False):
        fixed = ITRS(
            CartesianRepresentation(*source.place_m[keep : keep + len(rows)].T * u.m), obstime=times
        )
        theirs = fixed.transform_to(GCRS(obstime=times)).cartesian.xyz.to_value(u.m).T
    assert np.linalg.norm(rows[:, 1:4] - theirs, axis=1).max() < 0.02


@pytest.mark.parametrize(
    ("scale", "tai_minus_s"),
    [("GPS", 19), ("GAL", 19), ("QZS", 19), ("IRN", 19), ("BDT", 33), ("BDS", 33),
     ("TAI", 0), ("UTC", 37), ("GLO", 37), ("ccc", 19), ("   ", 19)],
)  # fmt: skip
def test_time_systems_of_sp3(scale: str, tai_minus_s: int, tmp_path: Path) -> None:
    """Each satellite system's midnight in TAI (SP3-d; BeiDou's began with 33 s of leap seconds)."""
    place = "".join(f"{v:14.6f}" for v in (15_000.0, -20_000.0, 9_000.0))
    rows = [f"*  2017  2 14  0 {m:2d}  0.00000000\nPC01{place}" for m in (0, 15)]
    head = f"#dP2017  2 14  0  0  0.00000000\n%c M  cc {scale} ccc cccc\n"
    (tmp_path / "a.sp3").write_text(head + "\n".join(rows) + "\nEOF\n")
    (found,) = read_ephemeris(tmp_path / "a.sp3", None, SCENE["epoch"], "f")["C01"]
    known = Time("2017-02-14T00:00:00", scale="tai") + tai_minus_s * u.s
    told = Time(found.utc1[0], found.utc2[0], format="jd", scale="utc")
    assert abs((told - known).sec) < 1e-6
    assert found.frame == "itrf"
    assert found.place_m[0] == pytest.approx([1.5e7, -2e7, 9e6])


@pytest.mark.parametrize("absent", [(), (1,), (0, 1, 2)])
def test_velocities_of_sp3_that_are_zeros_are_not_known(
    absent: tuple[int, ...], tmp_path: Path
) -> None:
    """As its standard has it: of all rows, or of one, the speeds follow from the places."""
    rows = []
    for m in range(3):
        speed = 0.0 if m in absent else 30_000.0
        rows.append(f"*  2017  2 14  0 {15 * m:2d}  0.00000000")
        rows += [f"{k}C01" + f"{v:14.6f}" * 3 for k, v in (("P", 9_000.0 + m), ("V", speed))]
    (tmp_path / "a.sp3").write_text("#dV2017\n" + "\n".join(rows) + "\nEOF\n")
    (found,) = read_ephemeris(tmp_path / "a.sp3", None, SCENE["epoch"], "f")["C01"]
    assert len(found.place_m) == 3
    assert (found.speed_m_s is None) == bool(absent)


def test_sp3_between_its_rows(shared_data: Path) -> None:
    """Every second row omitted comes back within the error that the thinned table states."""
    path = sp3(shared_data)
    for name in ("G01", "G12", "G30"):
        orbit = table({"kind": "ephemeris", "path": str(path), "object": name.lower()})
        rows = np.array(orbit.rows)
        assert orbit.error_m is not None
        assert orbit.error_m < 0.01
        thin, inner = rows[::2], rows[1:-1:2]
        nodes, error = best_nodes(thin[:, 0], thin[:, 1:4], None)
        update = {"rows": tuple(map(tuple, thin)), "nodes": nodes, "error_m": None}
        thinned = orbit.model_copy(update=update)
        place, _ = states(thinned, inner[:, 0])
        assert np.linalg.norm(place - inner[:, 1:4], axis=1).max() <= error
        for given in (nodes, None):
            found = table_error_m(thinned.model_copy(update={"nodes": given}))
            assert found == (nodes, error, True)


def write_csv(path: Path, unit: str = "m", velocities: bool = True, scale: str = "utc") -> Any:
    """A two-body orbit every 30 s for an hour before and after the scene's epoch."""
    t = np.arange(-3600.0, 3601.0, 30.0)
    place, speed = two_body(np.array([7e6, 0, 0]), np.array([0, 6000.0, 5500.0]), t)
    k = 1e-3 if unit == "km" else 1.0
    names = ["time_s" if scale == "s" else f"time_{scale}", *(f"{a}_{unit}" for a in "xyz")]
    names += [f"v{a}_{unit}_s" for a in "xyz"] if velocities else ["valid"]
    begin = Time("2017-02-14T06:07:00", scale="utc", precision=9)
    lines = [", ".join(names)]
    for i, s in enumerate(t):
        at = begin + s * u.s
        when = repr(float(s)) if scale == "s" else getattr(at, scale).isot
        numbers = [*(k * place[i]), *((k * speed[i]) if velocities else [1.0])]
        lines.append(", ".join([when, *(f"{x:.9f}" for x in numbers)]))
    path.write_text("\n".join(lines) + "\n")
    return lambda at: two_body(np.array([7e6, 0, 0]), np.array([0, 6000.0, 5500.0]), at)


@pytest.mark.parametrize("unit", ["m", "km"])
@pytest.mark.parametrize("scale", ["utc", "tai", "tt", "tdb", "s"])
@pytest.mark.parametrize("velocities", [True, False])
def test_csv(tmp_path: Path, unit: str, scale: str, velocities: bool) -> None:
    path = tmp_path / "orbit.csv"
    truth = write_csv(path, unit, velocities, scale)
    orbit = table({"kind": "ephemeris", "path": str(path), "frame": "gcrs"})
    assert orbit.error_m is not None
    assert orbit.error_m < 0.1
    at = np.linspace(-0.5, 60.0, 31)
    place, speed = states(orbit, at)
    room = orbit.error_m + 2e-3
    assert np.linalg.norm(place - truth(at)[0], axis=1).max() < room
    assert np.linalg.norm(speed - truth(at)[1], axis=1).max() < 0.1 * room


def oem(
    frame: str, places: np.ndarray, speeds: np.ndarray, times: list[str], scale: str = "UTC"
) -> str:
    rows = "\n".join(
        " ".join([t, *(f"{x:.9f}" for x in 1e-3 * np.concatenate([p, v]))])
        for t, p, v in zip(times, places, speeds, strict=True)
    )
    return f"""CCSDS_OEM_VERS = 2.0
CREATION_DATE = 2017-02-14T00:00:00
ORIGINATOR = TEST
META_START
OBJECT_NAME = SAT
OBJECT_ID = 2017-001A
CENTER_NAME = EARTH
REF_FRAME = {frame}
TIME_SYSTEM = {scale}
START_TIME = {times[0]}
STOP_TIME = {times[-1]}
META_STOP
COMMENT rows
{rows}
COVARIANCE_START
EPOCH = {times[0]}
1.0
COVARIANCE_STOP
"""


# From GCRS to the mean equator and equinox of J2000.0, three small turns (IERS Conventions 2010,
# equation 5.33 and section 5.5.4; mas).
FRAME_BIAS = (
    rotation_matrix(6.8192 * u.mas, "x")
    @ rotation_matrix(-16.617 * u.mas, "y")
    @ rotation_matrix(-14.6 * u.mas, "z")
)


@pytest.mark.parametrize("frame", ["EME2000", "GCRF", "ITRF2014", "TEME"])
def test_oem_frames_against_astropy(tmp_path: Path, frame: str) -> None:
    """The same orbit told in three frames by astropy comes back in GCRS, velocity and all."""
    t = np.arange(-1800.0, 1801.0, 60.0)
    place, speed = two_body(np.array([7e6, 0, 0]), np.array([0, 6000.0, 5500.0]), t)
    times = Time("2017-02-14T06:07:00", scale="utc") + t * u.s
    told = CartesianRepresentation(
        *place.T * u.m, differentials=CartesianDifferential(*speed.T * u.m / u.s)
    )
    with iers.conf.set_temp("auto_download", False):
        source = GCRS(told, obstime=times)
        if frame == "EME2000":
            source = GCRS(told.transform(FRAME_BIAS), obstime=times)
        elif frame != "GCRF":
            kind = ITRS if frame == "ITRF2014" else TEME
            source = source.transform_to(kind(obstime=times))
    shown = source.cartesian.xyz.to_value(u.m).T
    motion = source.cartesian.differentials["s"].d_xyz.to_value(u.m / u.s).T
    path = tmp_path / "sat.oem"
    # day of the year in one of them: both CCSDS forms are read
    texts = [x.yday.replace(":", "-", 1).replace(":", "T", 1) if frame == "TEME" else x.isot
             for x in times]  # fmt: skip
    path.write_text(oem(frame, shown, motion, texts))
    orbit = table({"kind": "ephemeris", "path": str(path), "object": "2017-001A"})
    at = np.linspace(0.0, 60.0, 7)
    found, moving = states(orbit, at)
    true, true_speed = two_body(np.array([7e6, 0, 0]), np.array([0, 6000.0, 5500.0]), at)
    assert np.linalg.norm(found - true, axis=1).max() < 0.05
    assert np.linalg.norm(moving - true_speed, axis=1).max() < 2e-3


@pytest.mark.parametrize("scale", ["TT", "TDB", "TAI"])
def test_oem_time_scales_against_astropy(tmp_path: Path, scale: str) -> None:
    """The same instants told in another scale by astropy come back, to a microsecond."""
    t = np.arange(-1800.0, 1801.0, 60.0)
    place, speed = two_body(np.array([7e6, 0, 0]), np.array([0, 6000.0, 5500.0]), t)
    times = Time("2017-02-14T06:07:00", scale="utc", precision=9) + t * u.s
    path = tmp_path / "sat.oem"
    texts = list(getattr(times, scale.lower()).isot)
    path.write_text(oem("GCRF", place, speed, texts, scale))
    orbit = table({"kind": "ephemeris", "path": str(path), "object": "2017-001A"})
    found, _ = states(orbit, np.array([0.0, 60.0]))
    true = place[[30, 31]]
    assert np.linalg.norm(found - true, axis=1).max() < 0.01


@pytest.mark.parametrize("order", [(-1, 0, 1), (0, 1, -1), (1, -1, 0)])
def test_the_segment_that_covers_the_exposures(tmp_path: Path, order: tuple[int, ...]) -> None:
    """Of three segments an hour long, in any order, each of an orbit of its own."""
    t = np.arange(-1800.0, 1801.0, 60.0)
    start = Time("2017-02-14T06:07:00", scale="utc")
    parts, places = [], {}
    for k in order:
        places[k], speed = two_body(np.array([7e6 + 1e5 * k, 0, 0]), np.array([0, 6e3, 5500.0]), t)
        texts = list((start + (t + 4000.0 * k) * u.s).isot)
        part = oem("GCRF", places[k], speed, texts)
        parts.append(part if not parts else part[part.index("META_START") :])
    (tmp_path / "sat.oem").write_text("".join(parts))
    orbit = table({"kind": "ephemeris", "path": str(tmp_path / "sat.oem"), "object": "2017-001A"})
    found, _ = states(orbit, np.array([0.0, 60.0]))
    assert np.linalg.norm(found - places[0][[30, 31]], axis=1).max() < 0.05


def test_earth_fixed_rows_across_a_leap_second(tmp_path: Path) -> None:
    """UT1 - UTC jumps there, the Earth does not: against astropy, half an hour to either side."""
    t = np.arange(-1800.0, 1801.0, 60.0)
    place, speed = two_body(np.array([7e6, 0, 0]), np.array([0, 6000.0, 5500.0]), t)
    times = Time("2017-01-01T00:00:00", scale="utc") + t * u.s
    with iers.conf.set_temp("auto_download", False):
        told = GCRS(CartesianRepresentation(*place.T * u.m), obstime=times)
        fixed = told.transform_to(ITRS(obstime=times)).cartesian.xyz.to_value(u.m).T
    path = tmp_path / "sat.oem"
    path.write_text(oem("ITRF2014", fixed, speed, list(times.isot)))
    ((source,),) = read_ephemeris(path, None, SCENE["epoch"], "f").values()
    found, _ = to_gcrs(source, slice(None))
    assert np.linalg.norm(found - place, axis=1).max() < 0.05


def test_a_row_of_an_oem_without_its_velocity_leaves_all_to_the_places(tmp_path: Path) -> None:
    """Speeds then follow from the places, as in an SP3 file; the rows are all there."""
    t = np.arange(0.0, 1201.0, 60.0)
    place, speed = two_body(np.array([7e6, 0, 0]), np.array([0, 6000.0, 5500.0]), t)
    times = list((Time("2017-02-14T06:07:00", scale="utc") + t * u.s).isot)
    text = oem("GCRF", place, speed, times)
    (row,) = (line for line in text.splitlines() if line.startswith(times[3] + " "))
    path = tmp_path / "sat.oem"
    for written, known in ((text, True), (text.replace(row, " ".join(row.split()[:4])), False)):
        path.write_text(written)
        ((source,),) = read_ephemeris(path, None, SCENE["epoch"], "f").values()
        assert source.place_m == pytest.approx(place, abs=1e-3)
        assert (source.speed_m_s is not None) == known


def test_each_segment_has_its_own_metadata(tmp_path: Path) -> None:
    """What the first one says of where it may be used is nothing to the second, an hour later."""
    t = np.arange(-1800.0, 1801.0, 60.0)
    place, speed = two_body(np.array([7e6, 0, 0]), np.array([0, 6000.0, 5500.0]), t)
    start = Time("2017-02-14T06:07:00", scale="utc")
    first, second = (
        oem("GCRF", place, speed, list((start + (t + late) * u.s).isot)) for late in (0.0, 4e3)
    )
    stop = f"USEABLE_STOP_TIME = {(start + 600.0 * u.s).isot}\nMETA_STOP"
    path = tmp_path / "sat.oem"
    path.write_text(first.replace("META_STOP", stop) + second[second.index("META_START") :])
    (segments,) = read_ephemeris(path, None, SCENE["epoch"], "f").values()
    until = [Time(*(part[1] for part in one.useable), format="jd", scale="utc") for one in segments]
    assert [round((t - start).sec) for t in until] == [600, 5800]


@pytest.mark.parametrize("day", ["366", "000"])
def test_a_day_that_the_year_does_not_have(tmp_path: Path, day: str) -> None:
    """Day 366 of 2017 was taken for its first."""
    place, speed = two_body(np.array([7e6, 0, 0]), np.array([0, 6000.0, 5500.0]), np.arange(2.0))
    path = tmp_path / "sat.oem"
    path.write_text(oem("GCRF", place, speed, [f"2017-{day}T06:00:0{i}" for i in range(2)]))
    with pytest.raises(BadInput, match=f"time 2017-{day}T06:00:00 of sat.oem"):
        table({"kind": "ephemeris", "path": str(path)})


def test_rows_beyond_the_useable_times_hold_the_polynomials(tmp_path: Path) -> None:
    """Useable from 5 s before the exposures, between two rows: to a micrometre of the orbit, which
    rows on one side alone do not give. Exposures beyond are refused, by the times that are told."""
    t = np.arange(-960.0, 2401.0, 240.0)
    start = Time("2017-02-14T06:07:00", scale="utc")
    place, speed = two_body(np.array([7e6, 0, 0]), np.array([0, 6000.0, 5500.0]), t)
    text = oem("GCRF", place, speed, list((start + t * u.s).isot))
    path = tmp_path / "sat.oem"
    for first_s, accepted in ((-5.0, True), (5.0, False)):
        use = f"USEABLE_START_TIME = {(start + first_s * u.s).isot}\nMETA_STOP"
        path.write_text(text.replace("META_STOP", use))
        if accepted:
            found, _ = states(table({"kind": "ephemeris", "path": str(path)}), np.array([0.0, 60]))
            true, _ = two_body(np.array([7e6, 0, 0]), np.array([0, 6e3, 5500.0]), np.array([0, 60]))
            assert np.linalg.norm(found - true, axis=1).max() < 1e-5
        else:
            with pytest.raises(BadInput, match="06:07:05") as refused:
                table({"kind": "ephemeris", "path": str(path)})
            assert refused.value.field == "targets.0.orbit.path"


@pytest.mark.parametrize("frame", ["TEME", "ITRF2014", "GCRF"])
def test_axes_of_date_that_are_held_at_an_epoch(tmp_path: Path, frame: str) -> None:
    """502.0-B-3, table 5-3: REF_FRAME_EPOCH holds axes that turn with the date; from J2000 to 2017
    those of TEME turn by 0.2 degrees. It says nothing of axes that never turn."""
    t = np.arange(-600.0, 601.0, 60.0)
    place, speed = two_body(np.array([7e6, 0, 0]), np.array([0, 6000.0, 5500.0]), t)
    text = oem(frame, place, speed, list((Time("2017-02-14T06:07:00", scale="utc") + t * u.s).isot))
    held = f"REF_FRAME = {frame}\nREF_FRAME_EPOCH = 2000-01-01T12:00:00\n"
    path = tmp_path / "sat.oem"
    path.write_text(text.replace(f"REF_FRAME = {frame}\n", held))
    if frame == "GCRF":
        assert table({"kind": "ephemeris", "path": str(path)}).nodes
    else:
        with pytest.raises(BadInput, match=f"{frame} of date"):
            table({"kind": "ephemeris", "path": str(path)})


def test_one_file_in_two_frames_and_from_two_epochs(tmp_path: Path) -> None:
    """Each target has the frame and the epoch that it names, though the file is read once for
    each."""
    path = tmp_path / "orbit.csv"
    write_csv(path, scale="s")
    plain = {"kind": "ephemeris", "path": str(path)}
    epochs: list[dict[str, str]] = [{}, {"epoch": "2017-02-14T05:57:00Z"}]
    asked = [plain | {"frame": frame} | e for frame in ("gcrs", "teme") for e in epochs]
    data = copy.deepcopy(SCENE)
    data["targets"] = [
        {"name": f"t{i}", "body": BODY, "orbit": orbit} for i, orbit in enumerate(asked)
    ]
    found = [target.orbit for target in gather_ephemerides(parse_scene(data)).targets]
    rows = [orbit.rows for orbit in found]  # type: ignore[union-attr]
    assert rows == [table(orbit).rows for orbit in asked]
    assert len(set(rows)) == 4


def test_pole_against_astropy() -> None:
    for day in ("2017-02-14", "2026-01-05"):
        x, y = iers.IERS_A.open(iers.IERS_A_FILE).pm_xy(Time(day))
        ours = np.radians(np.array(gather_pole_arcsec(*parse_utc(f"{day}T00:00:00Z"))) / 3600.0)
        assert ours == pytest.approx((x.to_value(u.rad), y.to_value(u.rad)), abs=5e-9)


def omm_fields() -> dict[str, Any]:
    fields = exporter.export_omm(Satrec.twoline2rv(*LINES, WGS72), "ISS")
    return fields | {"MEAN_ELEMENT_THEORY": "SGP4", "REF_FRAME": "TEME", "TIME_SYSTEM": "UTC"}


def omm_text(kind: str) -> str:
    fields = omm_fields()
    if kind == "json":
        return json.dumps([fields | {"CREATION_DATE": "2019-04-20", "GP_ID": 7}], default=str)
    if kind == "kvn":
        return "CCSDS_OMM_VERS = 2.0\n" + "\n".join(f"{k} = {v}" for k, v in fields.items())
    inside = {
        "metadata": ("OBJECT_NAME", "OBJECT_ID", "CENTER_NAME", "REF_FRAME", "TIME_SYSTEM"),
        "meanElements": ("EPOCH", "MEAN_MOTION", "ECCENTRICITY", "INCLINATION", "RA_OF_ASC_NODE",
                         "ARG_OF_PERICENTER", "MEAN_ANOMALY"),
        "tleParameters": ("NORAD_CAT_ID", "BSTAR"),
    }  # fmt: skip
    parts = {
        tag: "".join(f"<{k}>{fields[k]}</{k}>" for k in keys if k in fields)
        for tag, keys in inside.items()
    }
    return (
        f"<ndm><omm><body><segment><metadata>{parts['metadata']}</metadata><data><meanElements>"
        f"{parts['meanElements']}</meanElements><tleParameters>{parts['tleParameters']}"
        "</tleParameters></data></segment></body></omm></ndm>"
    )


@pytest.mark.parametrize("kind", ["json", "kvn", "xml"])
def test_omm_is_the_tle(tmp_path: Path, kind: str) -> None:
    """The same elements as lines and as a message: the same places to the epoch's microsecond."""
    path = tmp_path / f"iss.{kind}"
    path.write_text(omm_text(kind))
    epoch = "2019-04-20T06:00:00Z"
    found = gather_ephemerides(scene({"kind": "omm", "path": str(path)}, epoch)).targets[0].orbit
    assert isinstance(found, OmmOrbit)
    tle = scene({"kind": "tle", "line1": LINES[0], "line2": LINES[1]}, epoch).targets[0].orbit
    at = np.linspace(0.0, 3600.0, 5)
    ours, theirs = states(found, at, epoch), states(tle, at, epoch)
    assert np.abs(ours[0] - theirs[0]).max() < 0.01
    assert np.abs(ours[1] - theirs[1]).max() < 1e-5


@pytest.mark.parametrize("kind", ["json", "kvn", "xml"])
def test_an_omm_may_count_the_days_of_the_year(tmp_path: Path, kind: str) -> None:
    """Both CCSDS forms of a time (301.0-B-4, ASCII codes A and B) are the same epoch; day 366 of
    2019 is no day of the next year, but refused as it stands with all other times."""
    path = tmp_path / "iss.omm"
    path.write_text(omm_text(kind))
    plain = gather_ephemerides(scene({"kind": "omm", "path": str(path)}, "2019-04-20T03:00:00Z"))
    path.write_text(omm_text(kind).replace("2019-04-20T02", "2019-110T02"))
    assert "-110T" in path.read_text()
    asked = scene({"kind": "omm", "path": str(path)}, "2019-04-20T03:00:00Z")
    assert gather_ephemerides(asked).targets == plain.targets
    path.write_text(path.read_text().replace("-110T", "-366T"))
    (found,) = read_omm(path, "f").values()
    assert found["epoch"].startswith("2019-366T")
    with pytest.raises(BadInput, match="2019-366T"):
        parse_utc(found["epoch"])


def test_an_omm_name_keeps_its_brackets_and_a_number_loses_its_unit(tmp_path: Path) -> None:
    """As names are (CelesTrak's STARLINK-11072 [DTC]), and as CCSDS writes units in KVN."""
    path = tmp_path / "named.omm"
    text = omm_text("kvn").replace("OBJECT_NAME = ISS", "OBJECT_NAME = ISS [DTC]")
    (wanted,) = read_omm(_written(path, text), "f").values()
    mean = f"MEAN_MOTION = {omm_fields()['MEAN_MOTION']}"
    assert mean in text
    text = text.replace(mean, f"{mean} [rev/day]")
    ((name, found),) = read_omm(_written(path, text), "f").items()
    assert name.startswith("ISS [DTC] | ")
    assert found == wanted


def _written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_rows_are_kept_for_other_times_that_are_asked_for(tmp_path: Path) -> None:
    """Of a light curve beyond the exposures."""
    true = write_csv(tmp_path / "a.csv")
    made = scene({"kind": "ephemeris", "path": str(tmp_path / "a.csv"), "frame": "gcrs"})
    spans = (None, (-900.0, 2400.0))
    few, more = (gather_ephemerides(made, also).targets[0].orbit for also in spans)
    assert len(few.rows) < len(more.rows)
    at = np.array([-900.0, 2400.0])
    np.testing.assert_allclose(states(more, at)[0], true(at)[0], atol=1e-2)
    with pytest.raises(BadInput, match="one stretch of rows over all times, 2017-02-14T05:"):
        gather_ephemerides(made, (-3700.0, 0.0))


def test_observer_from_a_file_and_scenes_without(tmp_path: Path) -> None:
    bare = parse_scene(SCENE)
    assert gather_ephemerides(bare) is bare
    path = tmp_path / "orbit.csv"
    write_csv(path)
    data = copy.deepcopy(SCENE)
    data["observer"] = {
        "kind": "orbit", "orbit": {"kind": "ephemeris", "path": str(path), "frame": "gcrs"},
    }  # fmt: skip
    try:
        asked = parse_scene(data)
    except BadInput:
        pytest.skip("observers take two kinds of orbit in this version")
    assert isinstance(asked.observer.orbit, EphemerisOrbit)  # type: ignore[union-attr]
    assert isinstance(gather_ephemerides(asked).observer.orbit, TableOrbit)  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("name", "text", "orbit", "words"),
    [
        ("a.oem", "", {}, "OEM"),
        ("a.csv", "time_utc,x_m,y_m,z_m\n2017-02-14T06:00:00,1,2\n", {"frame": "gcrs"}, "4 values"),
        ("a.csv", "time_utc,x_m,y_m,z_m\n2017-02-14T06:00:00,1,2,3\n", {}, "gcrs, eme2000, itrf"),
        ("a.csv", "time_utc,x_m,y_m,z_m\n2017-02-14T06:00:00,1,2,3\n", {"frame": "itrf"}, "2 rows"),
        ("a.csv", "time_utc,x,y,z\n2017-02-14T06:00:00,1,2,3\n", {"frame": "itrf"}, "x_m, y_m"),
        ("a.csv", "time_utc,x_m,y_m,z_m\nnoon,1,2,3\n", {"frame": "itrf"}, "2019-04-20"),
        ("a.csv", "time_s,x_m,y_m,z_m\n0,1,nan,3\n1,1,2,3\n", {"frame": "gcrs"}, "finite"),
        ("a.csv", "time_s,x_m,y_m,z_m\n0,1,-2e13,3\n1,1,2,3\n", {"frame": "gcrs"}, "finite"),
        ("a.csv", "time_s,x_m,y_m,z_m\n0,1,2,3\n0,1,2,3\n", {"frame": "gcrs"}, "increasing"),
        ("a.csv", "time_s,x_m,y_m,z_m\n0,1,x,3\n0,1,2,3\n", {"frame": "gcrs"}, "numbers"),
        ("a.csv", "time_s,x_m,y_m,z_m\n-9,7e6,2,3\n20,7e6,2,3\n", {"frame": "gcrs"}, "06:08:00"),
        ("a.sp3", "#cP2017\n*  2017  2 14  0  0  0.0\nPG01 x y z\n", {}, "SP3 numbers"),
        ("a.sp3", "#cP2017\n", {}, "epochs"),
        ("a.oem", HEAD + "REF_FRAME = TOD\nTIME_SYSTEM = UTC\nMETA_STOP\n"
         "2017-02-14T06:00:00 1 2 3\n", {}, "REF_FRAME"),
        ("a.oem", HEAD + "REF_FRAME = GCRF\nTIME_SYSTEM = MRT\nMETA_STOP\n"
         "2017-02-14T06:00:00 1 2 3\n", {}, "time scale"),
        ("a.sp3", "#cP2017\n*  2017  2 14  0\n", {}, "SP3 numbers; an epoch of six"),
        ("a.csv", "time_s,x_m,y_m,z_m\n", {"frame": "gcrs"}, "at least one row"),
        ("a.csv", 'time_s,x_m,y_m,z_m\n"' + 140_000 * "1,", {"frame": "gcrs"}, "a readable table"),
        ("a.csv", "time_s,x_m,y_m,z_m, X_m\n0,1,2,3,1\n1,1,2,3,1\n", {"frame": "gcrs"}, "once"),
        ("a.csv", "time_utc,x_m,y_m,z_m\n2019-05-12T23:59:60,1,2,3\n2019-05-13T00:01:00,1,2,3\n",
         {"frame": "gcrs"}, "dates that exist"),
        ("a.csv", "time_tai,x_m,y_m,z_m\n2019-05-12T23:59:61.5,1,2,3\n2019-05-13T00:01:00,1,2,3\n",
         {"frame": "gcrs"}, "dates that exist"),
    ],
)  # fmt: skip
def test_limits_damaged_tables(
    tmp_path: Path, name: str, text: str, orbit: dict[str, Any], words: str
) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(BadInput) as told:
        table({"kind": "ephemeris", "path": str(tmp_path / name)} | orbit)
    assert words in str(told.value), str(told.value)
    assert told.value.field.startswith("targets.0.orbit")


def test_sixty_seconds_that_a_writer_rounded_are_the_next_minute(tmp_path: Path) -> None:
    text = "time_utc,x_m,y_m,z_m\n2019-05-12T{},7e6,0,0\n2019-05-12T12:40:00,7e6,1,1\n"
    found = []
    for moment in ("12:34:60.000", "12:35:00"):
        path = tmp_path / "a.csv"
        path.write_text(text.format(moment))
        ((one,),) = read_ephemeris(path, "gcrs", "2019-05-12T12:00:00Z", "f").values()
        found.append(one.utc1[0] + one.utc2[0])
    assert found[0] == found[1]


def test_limits_missing_large_and_binary_files(tmp_path: Path) -> None:
    for path in (tmp_path / "none.csv", tmp_path):
        with pytest.raises(BadInput, match="existing file"):
            table({"kind": "ephemeris", "path": str(path), "frame": "gcrs"})
    (tmp_path / "binary").write_bytes(b"\xff\xfe\x00" * 9)
    with pytest.raises(BadInput, match="UTF-8"):
        table({"kind": "ephemeris", "path": str(tmp_path / "binary")})
    with (tmp_path / "huge").open("wb") as file:
        file.truncate(300_000_000)
    with pytest.raises(BadInput, match="at most"):
        table({"kind": "ephemeris", "path": str(tmp_path / "huge")})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"MEAN_ELEMENT_THEORY": "SGP4-XP"}, "MEAN_ELEMENT_THEORY SGP4"),
        ({"EPHEMERIS_TYPE": 4}, "EPHEMERIS_TYPE"),
        ({"CENTER_NAME": "MOON"}, "CENTER_NAME EARTH"),
        ({"MEAN_MOTION": "fast"}, "a number"),
        ({"EPOCH": None}, "EPOCH"),
        ({"BSTAR": None}, "no BSTAR"),  # drag would be 0: 34 km after three days of 1.5e-4
        ({"REF_FRAME_EPOCH": "2000-01-01T12:00:00"}, "TEME of date"),
    ],
)
def test_limits_other_theories(tmp_path: Path, change: dict[str, Any], words: str) -> None:
    path = tmp_path / "a.json"
    path.write_text(json.dumps(omm_fields() | change, default=str))
    with pytest.raises(BadInput, match=words):
        read_omm(path, "targets.0.orbit.path")


@pytest.mark.parametrize("form", ["json", "xml"])
def test_a_mark_of_byte_order_is_no_part_of_the_text(tmp_path: Path, form: str) -> None:
    """As editors of some systems write it, and many tools as the first character of a table."""
    plain, marked = tmp_path / f"a.{form}", tmp_path / f"b.{form}"
    plain.write_text(omm_text(form), encoding="utf-8")
    marked.write_text(omm_text(form), encoding="utf-8-sig")
    assert read_omm(marked, "f") == read_omm(plain, "f")


def test_limits_xml_with_entities_and_the_wrong_object(tmp_path: Path) -> None:
    path = tmp_path / "a.xml"
    path.write_text('<!DOCTYPE x [<!ENTITY a "aaaa">]>' + omm_text("xml"))
    with pytest.raises(BadInput, match="DOCTYPE"):
        read_omm(path, "f")
    path.write_text(omm_text("json"))
    with pytest.raises(BadInput, match=r"targets\.0\.orbit\.object") as told:
        gather_ephemerides(scene({"kind": "omm", "path": str(path), "object": "HST"}))
    assert "ISS" in str(told.value)


@pytest.mark.parametrize("text", ["[1]", "[null]", '[{"OBJECT_NAME": "A"}, "B"]', "[[]]"])
def test_lists_of_no_messages(tmp_path: Path, text: str) -> None:
    (tmp_path / "omm.json").write_text(text)
    with pytest.raises(BadInput, match="an OMM as JSON"):
        read_omm(tmp_path / "omm.json", "orbit.path")


@pytest.mark.parametrize(
    ("first", "last", "taken"),
    [("1899-12-31", "1900-01-01", False), ("1900-01-01", "1900-01-02", True),
     ("2100-12-30", "2100-12-31", True), ("2100-12-31", "2101-01-01", False),
     ("2019-02-28", "2019-02-29", False), ("2020-02-28", "2020-02-29", True)],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore:.*dubious year")
def test_dates_exist_and_are_of_1900_to_2100(
    tmp_path: Path, first: str, last: str, taken: bool
) -> None:
    rows = "".join(f"{day}T06:00:00,7e6,{k},0\n" for k, day in enumerate((first, last)))
    (tmp_path / "a.csv").write_text(f"time_utc,x_m,y_m,z_m\n{rows}")
    if not taken:
        with pytest.raises(BadInput, match="dates that exist, years 1900 to 2100"):
            read_ephemeris(tmp_path / "a.csv", "GCRS", SCENE["epoch"], "f")
        return
    ((found,),) = read_ephemeris(tmp_path / "a.csv", "GCRS", SCENE["epoch"], "f").values()
    days = np.array([first, last], "datetime64[D]") - np.datetime64("2000-01-01")
    assert np.allclose(found.utc1 + found.utc2, 2451544.75 + days.astype(float), rtol=0, atol=1e-8)


def test_times_of_a_csv_are_finite(tmp_path: Path) -> None:
    rows = "\n".join(f"{t},7000,{t},0" for t in ("0", "nan", "20"))
    (tmp_path / "a.csv").write_text(f"time_s,x_km,y_km,z_km\n{rows}\n")
    with pytest.raises(BadInput, match=r"time_s of a\.csv.*finite"):
        read_ephemeris(tmp_path / "a.csv", "GCRS", SCENE["epoch"], "orbit.path")
