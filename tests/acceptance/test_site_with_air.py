"""A site that looks through air: truth, pixels, WCS and an independent account agree."""

from __future__ import annotations

import copy
import re

import numpy as np
import pyarrow.parquet as pq
import pytest
from astropy.io import fits
from astropy.wcs import WCS

from catalog_tools.ingest.ingest import ingest
from pipeline.errors import BadInput
from pipeline.export.files import export_frames
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.route.prepare import plan_scene, prepare
from pipeline.route.run import render
from pipeline.spec.load import parse_scene
from pipeline.store.cube import open_cube

SITE = {"kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3, "height_m": 3055}
AIR = {
    "extinction": {"mag_per_airmass": 0.3},
    "refraction": {"pressure_hpa": 700, "temperature_c": 8, "humidity": 0.2, "wavelength_nm": 600},
}
SCENE = {
    "schema": "nightglass/scene/1", "name": "air", "epoch": "2019-04-20T11:00:00Z", "seed": 4,
    "observer": SITE | {"atmosphere": AIR},
    "sensor": {
        "shape": [512, 640], "pixel_pitch_um": 10.0, "focal_length_m": 0.3, "aperture_m": 0.1,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 1.3}, "read_noise_e": 5.0, "adc_bits": 24,
    },
    "pointing": {"mode": "sidereal", "boresight_ra_deg": 300.0, "boresight_dec_deg": 5.0,
                 "roll_deg": 25.0},
    "exposure": {"integration_s": 10.0},
    "output": {"layers": ["dn", "stars_e"]},
}  # fmt: skip


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory) -> str:
    """Stars on a lattice, so that none disturbs another's centroid."""
    folder = tmp_path_factory.mktemp("lattice")
    n = np.arange(-12, 13) * 0.08
    ra, dec = (g.ravel() for g in np.meshgrid(300.0 + n, 5.0 + n))
    lines = ["source_id,ref_epoch,ra,dec,pmra,pmdec,phot_g_mean_mag"]
    lines += [
        f"{i + 1},2015.5,{a:.9f},{d:.9f},0,0,9.0"
        for i, (a, d) in enumerate(zip(ra, dec, strict=True))
    ]
    (folder / "stars.csv").write_text("\n".join(lines) + "\n")
    return str(ingest([folder / "stars.csv"], folder / "catalogue").catalogue.path)


def scene_of(catalogue, **changes):
    data = copy.deepcopy(SCENE) | changes
    return parse_scene(data | {"stars": {"catalogue": catalogue}} if catalogue else data)


def truth_of(product):
    table = pq.read_table(product / "truth" / "stars.parquet")
    return {name: np.asarray(table[name]) for name in table.column_names}


def centroid(image, x, y):
    x0, y0 = round(x), round(y)
    part = image[y0 - 8 : y0 + 9, x0 - 8 : x0 + 9].astype(float)
    rows, columns = np.mgrid[y0 - 8 : y0 + 9, x0 - 8 : x0 + 9]
    return (part * columns).sum() / part.sum(), (part * rows).sum() / part.sum()


def altaz(ra_deg, dec_deg, when, pressure_hpa):
    """Elevations [deg] of catalogue places by astropy."""
    from astropy import units as u
    from astropy.coordinates import AltAz, EarthLocation, SkyCoord
    from astropy.time import Time
    from astropy.utils import iers

    place = EarthLocation.from_geodetic(-156.3 * u.deg, 20.7 * u.deg, 3055 * u.m)
    frame = AltAz(
        obstime=Time(when, scale="utc"), location=place, pressure=pressure_hpa * u.hPa,
        temperature=8 * u.deg_C, relative_humidity=0.2, obswl=0.6 * u.um,
    )  # fmt: skip
    with iers.conf.set_temp("auto_download", False):
        return SkyCoord(ra_deg * u.deg, dec_deg * u.deg).transform_to(frame)


def test_truth_pixels_and_wcs_agree(catalogue, tmp_path):
    """Light where the truth says, the truth where the exported WCS has the catalogue's places."""
    product = tmp_path / "run"
    render(scene_of(catalogue), product)
    truth, cube = truth_of(product), open_cube(product)
    image = cube["stars_e"].values[0]
    inside = (truth["x_px"] > 15) & (truth["x_px"] < 625)
    inside &= (truth["y_px"] > 15) & (truth["y_px"] < 497)
    assert inside.sum() > 100
    for x, y in zip(truth["x_px"][inside], truth["y_px"][inside], strict=True):
        assert centroid(image, x, y) == pytest.approx((x, y), abs=0.02)
    (path,) = export_frames(product, "fits", tmp_path / "frame.fits", frame=0)
    x, y = WCS(fits.getheader(path)).all_world2pix(truth["ra_deg"], truth["dec_deg"], 0)
    np.testing.assert_allclose(x[inside], truth["x_px"][inside], atol=1e-3)
    np.testing.assert_allclose(y[inside], truth["y_px"][inside], atol=1e-3)
    centre = np.hypot(truth["x_px"] - 319.5, truth["y_px"] - 255.5).argmin()
    assert truth["ra_deg"][centre] == pytest.approx(300.0, abs=1e-4)
    # the names of places are those without air: the lattice's
    assert (truth["ra_deg"] - 300.0) / 0.08 == pytest.approx(
        np.round((truth["ra_deg"] - 300.0) / 0.08), abs=1e-3
    )


def test_elevations_against_astropy(catalogue, tmp_path):
    """Refracted elevations of the drawn stars, and their extinction, star by star."""
    product = tmp_path / "run"
    scene = scene_of(catalogue)
    render(scene, product)
    truth = truth_of(product)
    plan = prepare(scene).plan
    g = plan_geometry(plan.scene, np.zeros(1, np.int64), plan.dut1_s)
    from pipeline.physics.positions.focal_plane import deproject

    x, y = truth["x_px"], truth["y_px"]
    observed = deproject(plan.camera, g.attitude[0, g.middle], x, y)
    height = np.degrees(np.arcsin(observed @ g.air[0, g.middle, :3]))
    seen = altaz(truth["ra_deg"], truth["dec_deg"], "2019-04-20T11:00:05", 700.0)
    assert height.min() < 30.0
    assert 3600.0 * np.abs(height - seen.alt.deg).max() < 0.5  # polar motion: 0.3 arcsec
    dry = altaz(truth["ra_deg"], truth["dec_deg"], "2019-04-20T11:00:05", 0.0)
    assert (seen.alt.deg - dry.alt.deg).max() * 3600.0 > 60.0
    clear = scene_of(catalogue, observer=SITE | {"atmosphere": {"refraction": AIR["refraction"]}})
    render(clear, tmp_path / "clear")
    above = truth_of(tmp_path / "clear")
    from pipeline.physics.sky.extinction import air_mass

    expected = 10.0 ** (-0.4 * 0.3 * air_mass(np.sin(np.radians(height))))
    np.testing.assert_allclose(truth["electrons"] / above["electrons"], expected, rtol=2e-5)
    np.testing.assert_array_equal(truth["g_mag"], above["g_mag"])


def test_the_faintest_star_told_is_fainter_above_the_air(catalogue):
    """By 0.3 mag for each air mass (Kasten & Young 1989) at astropy's elevation."""
    limits = []
    for air in ({"extinction": {"mag_per_airmass": mag}} for mag in (0.0, 0.3)):
        s = scene_of(catalogue, observer=SITE | {"atmosphere": air})
        limits.append(plan_scene(s)["outlook"]["limiting_g_mag"])
    up = float(altaz(300.0, 5.0, "2019-04-20T11:00:05", 0.0).alt.deg)
    mass = 1.0 / (np.sin(np.radians(up)) + 0.50572 * (up + 6.07995) ** -1.6364)
    assert limits[0] - limits[1] == pytest.approx(0.3 * mass, abs=0.01)


def test_colours_are_told_apart_by_the_air_they_are_seen_through():
    """As the extinction itself, to a tenth: both of the frame's lowest place."""
    found = []
    site = SITE | {"atmosphere": {"extinction": True}}
    for ra_deg in (250.0, 300.0):
        pointing = SCENE["pointing"] | {"boresight_ra_deg": ra_deg}
        plan = prepare(scene_of(None, observer=site, pointing=pointing)).plan
        (told,) = [d.reason for d in plan.decisions if d.component == "atmosphere.extinction"]
        lost, apart = re.search(r", (\S+) mag at the frame's .* by up to (\S+) mag;", told).groups()
        found.append((float(lost), float(apart)))
    (lost, apart), (lost_low, apart_low) = found
    assert lost_low > 1.5 * lost
    assert apart_low / apart == pytest.approx(lost_low / lost, rel=0.1)


@pytest.mark.parametrize(
    ("values", "ends_nm"),
    [
        ([0, 1, 1, 0, 0], (350, 1000)),
        ([1, 1, 1, 1, 1], (350, 1100)),
        ([0, 0, 1, 0, 0], (400, 1000)),
    ],
)
def test_a_star_is_drawn_out_between_the_ends_of_the_scenes_band(values, ends_nm, tmp_path):
    """Beside Filippenko's (1982, PASP 94, 715) refractivity of dry air, in the scene's weather."""

    def refractivity(nm):
        wave2 = (1e3 / nm) ** 2  # [um^-2], at 15 C and 1013.25 hPa
        standard = 64.328 + 29498.1 / (146.0 - wave2) + 255.4 / (41.0 - wave2)
        return 1e-6 * standard * 700.0 / 1013.25 * 288.15 / 281.15

    rows = zip((350, 400, 600, 1000, 1100), values, strict=True)
    text = "\n".join(["wavelength_nm,response", *(f"{nm},{value}" for nm, value in rows)])
    (tmp_path / "band.csv").write_text(text)
    curve = {"kind": "table", "path": str(tmp_path / "band.csv")}
    scene = scene_of(None, sensor=SCENE["sensor"] | {"bandpass": curve})
    plan = prepare(scene).plan
    said = {d.component: d for d in plan.decisions}
    up_deg = float(re.search(r"\((\S+) deg up\)", said["atmosphere.refraction"].reason)[1])
    apart = refractivity(ends_nm[0]) - refractivity(ends_nm[1])
    wanted = np.degrees(apart) * 3600.0 / np.tan(np.radians(up_deg))
    assert said["atmosphere.dispersion"].bound == pytest.approx(wanted, rel=0.05)
    assert f"arcsec from {ends_nm[0]} to {ends_nm[1]} nm" in said["atmosphere.dispersion"].reason


def test_a_tracked_target_stays_in_the_centre_and_fades(tmp_path):
    """A rate track through air: the target at the centre, its light less the extinction, its place
    in the truth the one that the frame's WCS names there."""
    sphere = {"kind": "sphere", "diameter_m": 3.0, "albedo": 0.3}
    state = {"kind": "state", "position_m": [-36.0e6, -21.9e6, 0.0],
             "velocity_m_s": [1597.0, -2625.0, 0.0]}  # fmt: skip
    target = {"name": "t", "orbit": state, "body": sphere}
    changes = {"pointing": {"mode": "target", "target": "t"}, "targets": [target],
               "output": {"layers": ["dn", "targets_e"]}}  # fmt: skip
    electrons = []
    for name, air in (("air", AIR), ("none", {"refraction": True})):
        render(scene_of(None, **changes, observer=SITE | {"atmosphere": air}), tmp_path / name)
        row = pq.read_table(tmp_path / name / "truth" / "targets.parquet").to_pylist()[0]
        assert (row["x_px"], row["y_px"]) == pytest.approx((319.5, 255.5), abs=1e-5)
        light = open_cube(tmp_path / name)["targets_e"].values[0]
        assert light.sum() == pytest.approx(row["electrons"], rel=1e-3)
        (path,) = export_frames(tmp_path / name, "fits", tmp_path / f"{name}.fits", frame=0)
        seen_at = WCS(fits.getheader(path)).all_world2pix(row["ra_deg"], row["dec_deg"], 0)
        assert tuple(map(float, seen_at)) == pytest.approx((319.5, 255.5), abs=1e-3)
        lifted = abs(row["apparent_dec_deg"] - row["dec_deg"]) + abs(
            row["apparent_ra_deg"] - row["ra_deg"]
        )
        assert lifted > 0.005  # by the air: a place of the catalogue's kind knows none
        electrons.append(row["electrons"])
    assert 0.4 < electrons[0] / electrons[1] < 0.76


def test_the_horizon_is_refused():
    low = {"mode": "sidereal", "boresight_ra_deg": 319.0, "boresight_dec_deg": 5.0}
    for air, said in (({"refraction": True}, "3 degrees or more"),
                      ({"extinction": True}, "0 degrees or more")):  # fmt: skip
        pointing = dict(low, boresight_ra_deg=319.0 if "refraction" in air else 322.6)
        data = copy.deepcopy(SCENE) | {"pointing": pointing}
        data["observer"] = SITE | {"atmosphere": air}
        with pytest.raises(BadInput, match=said):
            plan_scene(parse_scene(data))


@pytest.mark.parametrize(
    ("place", "value", "said"),
    [
        (("observer", "atmosphere", "extinction", "mag_per_airmass"), -0.1, "greater than or eq"),
        (("observer", "atmosphere", "refraction", "humidity"), 1.5, "less than or equal"),
        (("observer", "atmosphere", "refraction", "presure_hpa"), 700, "did you mean"),
        (("observer", "atmosphere"), {}, "extinction, refraction or both"),
        (("background",), {"moonlight": True}, "atmosphere.extinction"),
        (("background",), {"airglow": {"solar_flux_sfu": 1000}}, "400"),
    ],
    ids=["negative", "humidity", "misspelt", "nothing", "moonlight", "activity"],
)
def test_mistakes(place, value, said):
    data = copy.deepcopy(SCENE)
    if place == ("background",) and "moonlight" in value:
        del data["observer"]["atmosphere"]["extinction"]
    holder = data
    for part in place[:-1]:
        holder = holder[part]
    holder[place[-1]] = value
    with pytest.raises(BadInput, match=said):
        parse_scene(data)


def test_light_of_the_air_needs_a_site():
    data = copy.deepcopy(SCENE) | {
        "observer": {"kind": "fixed", "position_au": [1, 0, 0]}, "background": {"airglow": True}
    }
    with pytest.raises(BadInput, match="kind ground"):
        parse_scene(data)


def test_daylight_is_refused():
    data = copy.deepcopy(SCENE) | {"background": {"twilight": True}}
    data["epoch"] = "2019-04-20T20:00:00Z"
    data["pointing"] = {"mode": "sidereal", "boresight_ra_deg": 60.0, "boresight_dec_deg": 20.0}
    with pytest.raises(BadInput, match=r"twilight: 'the Sun at [1-9].* deg of elevation"):
        plan_scene(parse_scene(data))
    plan = plan_scene(parse_scene(data | {"accept": ["daylight"]}))
    assert "the sky drawn is that of a night" in plan["warnings"][0]


def test_parts_of_the_night_sky_add_up(tmp_path):
    """Airglow, moonlight and zodiacal light: told in the plan, drawn in the frame."""
    data = copy.deepcopy(SCENE) | {
        "background": {"zodiacal": True, "airglow": True, "moonlight": True, "twilight": True},
        "output": {"layers": ["dn", "background_e"]},
    }
    plan = plan_scene(parse_scene(data))
    told = {d["component"]: d["reason"] for d in plan["decisions"]}
    names = ("zodiacal", "airglow", "moonlight", "twilight")
    spans = [
        [float(v) for v in told[f"background.{n}"].split(" e-/s")[0].split(" to ")] for n in names
    ]
    render(parse_scene(data), tmp_path / "run")
    image = open_cube(tmp_path / "run")["background_e"].values[0] / 10.0
    low, high = np.sum(spans, axis=0)
    assert 0.99 * low <= image.min() <= image.max() <= 1.01 * high
    assert min(s[0] for s in spans[:3]) > 0.0


@pytest.mark.parametrize(("ends_nm", "told"), [((557.0, 558.5), True), ((500.0, 600.0), False)])
def test_a_band_narrower_than_the_airglows_boxes_is_told(ends_nm, told):
    data = copy.deepcopy(SCENE) | {"background": {"airglow": True}}
    data["sensor"]["bandpass"] = {"kind": "box", "short_nm": ends_nm[0], "long_nm": ends_nm[1]}
    said = {d["component"]: d["reason"] for d in plan_scene(parse_scene(data))["decisions"]}
    assert ("up to 5.3 times as bright" in said["background.airglow"]) == told
