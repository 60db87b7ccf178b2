"""Measured magnitudes of Starlink satellites against stated models; no tuning per object.

Run: python -m benchmarks.satellite_brightness [--data FOLDER] [-o docs]. FOLDER holds the files of
Fankhauser, Tyson & Askari 2023 (AJ 166, 59): magnitudes from Mount Lemmon, BRDFs of the chassis and
the solar array from the laboratory, their areas. Prints the tables of satellite_brightness.md and
draws satellite_brightness.png.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import erfa.ufunc as era
import numpy as np
from numpy.typing import NDArray

from pipeline.physics.constants import DEG_RAD, EARTH_EQUATORIAL_RADIUS_M
from pipeline.physics.meshes.brdf import phong
from pipeline.physics.meshes.brdf_table import BrdfTable, brdf_table
from pipeline.physics.positions.apparent import apparent_sun_m
from pipeline.physics.positions.earth import earth_and_sun, gcrs_to_itrs
from pipeline.physics.positions.times import elapsed_s, instants, parse_utc
from pipeline.physics.targets.earthshine import earth_lamps
from pipeline.physics.targets.eclipse import sunlit_fraction
from pipeline.physics.targets.lighting import photon_rate_at_aperture, sun_distance
from pipeline.physics.vectors import unit
from pipeline.plan.bodies.attitudes import View
from pipeline.plan.bodies.bodies import earthshine_m2_sr
from pipeline.plan.bodies.shapes import reflected_m2_sr
from pipeline.spec.targets.body import CompositeBody, SphereBody

Array = NDArray[np.float64]
Brdf = Callable[[Array, Array, Array], Array]

DATA = Path(__file__).resolve().parents[2] / "shared/data/satellite_brightness/starlink_v15_pomenis"
SITE_DEG_M = (32.4434, -110.7881, 2790.0)  # Mount Lemmon; the height is not in the data
CHASSIS_M2, ARRAY_M2 = 3.64, 22.68  # starlink_surface_descriptions.txt
SUN_V_MAG, EARTH_ALBEDO = -26.76, 0.3
EDGE_DEG = 85.0  # laboratory values nearer to grazing are lost to the instrument
MIRROR_DEG = 3.0  # nearer to the mirror's direction is the mirrored beam itself
# Share that the chassis mirrors: its peaks in the laboratory, taken as round, hold 0.7 to 1.1
CHASSIS_MIRROR = 0.8
OFF_MIRROR_DEG = 30.0  # farther from the mirror's direction a surface counts as matt

# The published fit to these same magnitudes (areas of 1 m2): diffuse, specular, exponent
FITTED = {"chassis": (0.34, 0.40, 8.9), "array": (0.15, 0.25, 0.26)}


@dataclass(frozen=True)
class Facet:
    """A flat side [m2], black behind: its BRDF, and the share that it mirrors as glass does."""

    area_m2: float
    brdf: Brdf
    mirror: float = 0.0


@dataclass(frozen=True)
class Sightings:
    """n observations and their geometry.

    magnitude : (n,) AB; view : of one body at n times, GCRS; range_m, sunlit (n,)
    sun_from_earth_m : (n, 3); height_m : (n,) geodetic; elevation_rad, sun_elevation_rad : (n,)
    """

    magnitude: Array
    view: View
    range_m: Array
    sunlit: Array
    sun_from_earth_m: Array
    height_m: Array
    elevation_rad: Array
    sun_elevation_rad: Array

    @property
    def phase_deg(self) -> Array:
        """Angles Sun - satellite - observer (n,)."""
        return self.view.phase_rad[0] / DEG_RAD

    @property
    def normals(self) -> tuple[Array, Array]:
        """Where chassis and array look (n, 3): to the Earth; level, to the Sun's azimuth."""
        down = -unit(self.view.place_m[0])
        sun = self.view.sun[0]
        return down, unit(sun - np.sum(sun * down, -1, keepdims=True) * down)

    def sunward(self) -> NDArray[np.bool_]:
        """Seen on the Sun's side of the sky: only the chassis (and the array's back) faces us."""
        return np.sum(self.normals[1] * self.view.observer[0], -1) <= 0.0


def read_sightings(folder: Path) -> Sightings:
    """The observations of a folder with their geometry: time, direction and height fix places."""
    lines = (folder / "pomenis_observations.csv").read_text().splitlines()
    rows = list(csv.DictReader(s for s in lines if s.strip() and not s.startswith("#")))

    def column(name: str) -> Array:
        return np.array([row[name] for row in rows], float)

    epochs = [parse_utc(f"{row['observation_time']}Z") for row in rows]
    first = epochs[0]
    offsets = elapsed_s(first, *np.array(epochs).T)
    at = instants(first, offsets)
    height_m = 1e3 * column("satellite_height")
    elevation, azimuth = (column(f"satellite_{k}") * DEG_RAD for k in ("altitude", "azimuth"))
    latitude, longitude = (v * DEG_RAD for v in SITE_DEG_M[:2])
    site = era.gd2gc(1, longitude, latitude, SITE_DEG_M[2])[0]
    axes = _east_north_up(latitude, longitude)
    level = np.stack([np.sin(azimuth), np.cos(azimuth)]) * np.cos(elevation)
    sight = np.stack([*level, np.sin(elevation)], -1) @ axes
    range_m = _range_to_height(site, sight, height_m)
    to_gcrs = np.swapaxes(gcrs_to_itrs(at), -1, -2)
    place, observer = (
        np.einsum("nij,nj->ni", to_gcrs, v)
        for v in (site + range_m[:, None] * sight, np.broadcast_to(site, sight.shape))
    )
    earth = earth_and_sun(at.tt1, at.tt2)
    sun = apparent_sun_m(earth)
    # the plates' attitudes do not depend on which way the satellite flies
    speed = np.cross(place, [0.0, 0.0, 1e-3])
    view = View(*(v[None] for v in (offsets, place, speed, sun, observer)))
    up = np.einsum("nij,j->ni", to_gcrs, axes[2])
    sun_up = np.arcsin(np.sum(unit(sun) * up, -1))
    return Sightings(
        column("ab_magnitude"), view, range_m, sunlit_fraction(place, sun),
        earth.sun_from_earth_m, height_m, elevation, sun_up,
    )  # fmt: skip


def _east_north_up(latitude: float, longitude: float) -> Array:
    """Rows: unit vectors east, north and up at a geodetic site, Earth-fixed (3, 3)."""
    sb, cb, sl, cl = np.sin(latitude), np.cos(latitude), np.sin(longitude), np.cos(longitude)
    return np.array([[-sl, cl, 0.0], [-sb * cl, -sb * sl, cb], [cb * cl, cb * sl, sb]])


def _range_to_height(site: Array, sight: Array, height_m: Array) -> Array:
    """Distances (n,) [m] along lines of sight to geodetic heights on WGS 84, to 1 mm."""
    distance = height_m.copy()
    for _ in range(50):
        lon, lat, height, _ = era.gc2gd(1, site + distance[:, None] * sight)
        up = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], -1)
        step = (height_m - height) / np.sum(up * sight, -1)
        distance = distance + step
        if np.max(np.abs(step)) < 1e-3:
            break
    return distance


def laboratory_rows(path: Path) -> dict[float, Array]:
    """In-plane scans by angle of incidence [deg]: rows of signed angle (+ forward) [deg], BRDF."""
    table = np.loadtxt(path, comments="#")
    kept = table[np.abs(table[:, 2]) <= EDGE_DEG]
    return {float(t): kept[kept[:, 0] == t][:, [2, 4]] for t in np.unique(kept[:, 0])}


def laboratory_brdf(path: Path) -> BrdfTable:
    """A whole BRDF from scans in the plane of incidence at a few angles.

    Carried out of the plane as a function of how far the direction cosines lie from the mirror's
    (shift invariance; Harvey 1976, Univ. of Arizona), which the scan's side towards the light
    gives out to the widest offsets; every sunlit sight here lies on that side. The logarithm is
    linear between angles of incidence, held beyond the first and the last. Without the mirrored
    beam itself: within 3 degrees of it the value there holds.
    """
    scans = laboratory_rows(path)
    theta, phi = np.linspace(0.0, 90.0, 91) * DEG_RAD, np.linspace(0.0, 180.0, 91) * DEG_RAD
    ti, to, az = np.meshgrid(theta, theta, phi, indexing="ij")
    offset = np.hypot(np.sin(to) * np.cos(az) + np.sin(ti), np.sin(to) * np.sin(az))
    logs = []
    for angle, scan in scans.items():
        near = scan[scan[:, 0] <= angle - MIRROR_DEG][::-1]
        shift = np.sin(angle * DEG_RAD) - np.sin(near[:, 0] * DEG_RAD)
        logs.append(np.interp(offset, shift, np.log(near[:, 1])))
    angles = np.array(list(scans)) * DEG_RAD
    low = np.clip(np.searchsorted(angles, theta) - 1, 0, angles.size - 2)
    share = np.clip((theta - angles[low]) / (angles[low + 1] - angles[low]), 0.0, 1.0)
    stack, each = np.array(logs), np.arange(theta.size)
    w = share[:, None, None]
    value = np.exp((1.0 - w) * stack[low, each] + w * stack[low + 1, each])
    return brdf_table(theta, theta, phi, value, path.stem)


def matt_albedo(path: Path) -> float:
    """pi times the median laboratory BRDF farther than 30 degrees from the mirror's direction."""
    far = [s[np.abs(s[:, 0] - t) > OFF_MIRROR_DEG, 1] for t, s in laboratory_rows(path).items()]
    return float(np.pi * np.median(np.concatenate(far)))


def plates(chassis_albedo: float, array_albedo: float) -> CompositeBody:
    """The published satellite as matt plates: chassis to the Earth, array level to the Sun."""
    array = {"kind": "sun_tracking", "bus": "nadir", "axis": (0.0, 0.0, 1.0)}
    return CompositeBody.model_validate({
        "kind": "composite",
        "parts": (
            {"kind": "plate", "area_m2": CHASSIS_M2, "albedo": chassis_albedo,
             "attitude": {"kind": "nadir"}},
            {"kind": "plate", "area_m2": ARRAY_M2, "albedo": array_albedo, "attitude": array},
        ),
    })  # fmt: skip


def body_magnitudes(
    body: CompositeBody | SphereBody, s: Sightings, earth_albedo: float = EARTH_ALBEDO
) -> Array:
    """Magnitudes (n,) of a body of simple shapes in sunlight and earthshine."""
    epoch = (0.0, 0.0)
    direct = reflected_m2_sr([body], epoch, s.view)[0]
    return magnitudes(s, direct, earthshine_m2_sr(body, epoch, s.view, earth_albedo))


def surface_magnitudes(
    facets: tuple[Facet, Facet], s: Sightings, earth_albedo: float = EARTH_ALBEDO
) -> Array:
    """Magnitudes (n,) of chassis and array, neither shading nor hiding the other."""
    sun, observer = s.view.sun[0], s.view.observer[0]
    lamps, light = earth_lamps(s.view.place_m[0], s.view.sun_m[0], earth_albedo)
    direct, shine = np.zeros(s.range_m.shape), np.zeros(s.range_m.shape)
    for facet, n in zip(facets, s.normals, strict=True):
        cosine = np.sum(n * observer, -1)
        seen, brdf = facet.area_m2 * np.maximum(cosine, 0.0), facet.brdf
        direct += seen * np.maximum(np.sum(n * sun, -1), 0.0) * brdf(n, sun, observer)
        mirrored = 2.0 * cosine[:, None] * n - observer
        shine += seen * facet.mirror * earth_albedo / np.pi * sun_on_ground(s, mirrored)
        normal, towards = n[:, None], observer[:, None]
        fall = np.maximum(np.sum(normal * lamps, -1), 0.0) * light
        shine += seen * np.sum(brdf(normal, lamps, towards) * fall, -1)
    return magnitudes(s, direct, shine)


def sun_on_ground(s: Sightings, direction: Array) -> Array:
    """Cosine (n,) of the Sun's zenith angle where rays (n, 3) from the satellite meet the ground.

    On a round Earth; 0 at night and for rays that miss.
    """
    place = s.view.place_m[0]
    along = np.sum(place * direction, -1)
    under = along**2 - np.sum(place * place, -1) + EARTH_EQUATORIAL_RADIUS_M**2
    far = -along - np.sqrt(np.maximum(under, 0.0))
    up = unit(place + far[:, None] * direction)
    cosine = np.sum(up * unit(s.view.sun_m[0]), -1)
    return np.where((under > 0.0) & (far > 0.0), np.maximum(cosine, 0.0), 0.0)


def magnitudes(s: Sightings, direct_m2_sr: Array, earthshine_m2_sr: Array) -> Array:
    """Magnitudes (n,) above the atmosphere of intensities over the solar irradiance; inf: dark."""
    distance = sun_distance(s.view.place_m[0], s.sun_from_earth_m)
    at_earth = np.sqrt(np.sum(np.square(s.sun_from_earth_m), -1))
    flux = photon_rate_at_aperture(1.0, distance, s.sunlit, direct_m2_sr, s.range_m)
    flux = flux + photon_rate_at_aperture(1.0, at_earth, 1.0, earthshine_m2_sr, s.range_m)
    with np.errstate(divide="ignore"):
        return SUN_V_MAG - 2.5 * np.log10(flux)


def sphere_area_m2(s: Sightings) -> float:
    """Albedo times cross-section [m2] of the matt sphere in sunlight that fits best (rms)."""
    white = SphereBody(kind="sphere", diameter_m=2.0 / np.sqrt(np.pi), albedo=1.0)
    miss = body_magnitudes(white, s, 0.0) - s.magnitude
    return float(10.0 ** (0.4 * np.mean(miss[np.isfinite(miss)])))


def predictions(folder: Path, s: Sightings) -> dict[str, Array]:
    """Magnitudes (n,) by model; all but the last two are made without the measured magnitudes."""
    lab = [laboratory_brdf(folder / f"{k}_brdf.csv") for k in ("chassis", "solar_array")]
    matt = [matt_albedo(folder / f"{k}_brdf.csv") for k in ("chassis", "solar_array")]
    measured = (Facet(CHASSIS_M2, lab[0], CHASSIS_MIRROR), Facet(ARRAY_M2, lab[1]))
    fitted = [
        Facet(1.0, partial(phong, diffuse=d, specular=g, exponent=e)) for d, g, e in FITTED.values()
    ]
    sphere = SphereBody(
        kind="sphere", diameter_m=2.0 * np.sqrt(sphere_area_m2(s) / np.pi), albedo=1.0
    )
    return {
        "laboratory BRDFs": surface_magnitudes(measured, s),
        "the same, no earthshine": surface_magnitudes(measured, s, 0.0),
        "matt plates": body_magnitudes(plates(*matt), s),
        "published fit (Phong)": surface_magnitudes((fitted[0], fitted[1]), s, 0.0),
        "diffuse sphere": body_magnitudes(sphere, s, 0.0),
    }


@dataclass(frozen=True)
class Scatter:
    """Predicted minus measured magnitudes: how many could be predicted, and their statistics.

    mad : 1.4826 times the median distance from the median; r : correlation with the measured
    """

    count: int
    dark: int
    median: float
    rms: float
    spread: float
    mad: float
    r: float


def scatter(predicted: Array, measured: Array) -> Scatter:
    """Statistics of residuals (n,); objects predicted dark are counted, not used."""
    good = np.isfinite(predicted)
    miss = (predicted - measured)[good]
    middle = float(np.median(miss))
    r = float(np.corrcoef(predicted[good], measured[good])[0, 1])
    return Scatter(
        miss.size, int(np.sum(~good)), middle, float(np.sqrt(np.mean(miss**2))),
        float(np.std(miss)), float(1.4826 * np.median(np.abs(miss - middle))), r,
    )  # fmt: skip


def subsets(s: Sightings) -> dict[str, NDArray[np.bool_]]:
    """Parts of the observations, by what the data tell."""
    km, phase, dip = s.height_m / 1e3, s.phase_deg, s.sun_elevation_rad / DEG_RAD
    return {
        "away from the Sun (array's face seen)": ~s.sunward(),
        "Sun's side (chassis only)": s.sunward(),
        "height 530 to 560 km (in service)": (km >= 530.0) & (km <= 560.0),
        "other heights": (km < 530.0) | (km > 560.0),
        "phase below 60 deg": phase < 60.0,
        "phase 60 to 90 deg": (phase >= 60.0) & (phase < 90.0),
        "phase 90 deg and above": phase >= 90.0,
        "Sun above -12 deg": dip > -12.0,
        "Sun below -12 deg": dip <= -12.0,
        "elevation below 40 deg": s.elevation_rad < 40.0 * DEG_RAD,
        "elevation 40 deg and above": s.elevation_rad >= 40.0 * DEG_RAD,
    }


def table(named: dict[str, tuple[Array, Array]]) -> list[str]:
    """Markdown rows of (predicted, measured) by name."""
    heads = ["", "n", "dark", "median", "rms", "std. dev.", "MAD x 1.48", "r"]
    lines = ["| " + " | ".join(heads) + " |", "| --- |" + " ---: |" * 7]
    for name, (predicted, measured) in named.items():
        x = scatter(predicted, measured)
        values = (x.rms, x.spread, x.mad, x.r)
        numbers = [f"{x.median:+.2f}", *(f"{v:.2f}" for v in values)]
        lines.append(f"| {name} | {x.count} | {x.dark} | " + " | ".join(numbers) + " |")
    return lines


def report(s: Sightings, made: dict[str, Array]) -> tuple[list[str], list[str]]:
    """Tables by model, and of the laboratory model by subset."""
    models = {name: (values, s.magnitude) for name, values in made.items()}
    best = made["laboratory BRDFs"]
    parts = {k: (best[m], s.magnitude[m]) for k, m in subsets(s).items() if m.sum() > 2}
    return table(models), table(parts)


def draw(s: Sightings, made: dict[str, Array], path: Path) -> None:
    """Predicted against measured, residuals against phase angle and range, histograms."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 8.5), layout="constrained", dpi=110)
    (both, phase), (distance, histogram) = figure.subplots(2, 2)
    best, side = made["laboratory BRDFs"], s.sunward()
    ends = [float(np.min(s.magnitude)) - 0.5, float(np.max(s.magnitude)) + 0.5]
    both.plot(ends, ends, color="0.6", lw=1)
    for ax, x, y, label in (
        (both, s.magnitude, best, "measured [AB mag]"),
        (phase, s.phase_deg, best - s.magnitude, "phase angle Sun - satellite - observer [deg]"),
        (distance, s.range_m / 1e3, best - s.magnitude, "range [km]"),
    ):
        for which, name in ((~side, "away from the Sun"), (side, "Sun's side: chassis only")):
            ax.plot(x[which], y[which], ".", ms=4, alpha=0.6, label=f"{name} ({which.sum()})")
        ax.set(xlabel=label, ylabel="predicted - measured [mag], laboratory BRDFs")
    both.set(ylabel="predicted [mag], laboratory BRDFs", xlim=ends, ylim=ends)
    both.legend(fontsize=8)
    for ax in (phase, distance):
        ax.axhline(0.0, color="0.6", lw=1)
    bins = np.arange(-4.0, 5.01, 0.2)
    for name in ("laboratory BRDFs", "matt plates", "published fit (Phong)", "diffuse sphere"):
        fit = scatter(made[name], s.magnitude)
        label = f"{name}: median {fit.median:+.2f}, std. dev. {fit.spread:.2f}"
        miss = np.clip(made[name] - s.magnitude, bins[0], bins[-1])
        histogram.hist(miss, bins, histtype="step", lw=1.4, label=label)
    histogram.set(xlabel="predicted - measured [mag]", ylabel="observations per 0.2 mag")
    histogram.margins(y=0.35)
    histogram.legend(fontsize=8, loc="upper right")
    figure.savefig(path)


def main() -> None:
    """Print the tables and draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("-o", type=Path, default=Path("docs"))
    wish = parser.parse_args()
    s = read_sightings(wish.data)
    made = predictions(wish.data, s)
    for lines in report(s, made):
        print("\n".join(lines), end="\n\n")
    albedos = [matt_albedo(wish.data / f"{k}_brdf.csv") for k in ("chassis", "solar_array")]
    print(f"matt albedos {albedos[0]:.3f}, {albedos[1]:.4f}; sphere {sphere_area_m2(s):.3f} m2")
    draw(s, made, wish.o / "satellite_brightness.png")


if __name__ == "__main__":
    main()
