"""Gnomonic camera: directions to pixels and back, and the WCS that says the same in FITS."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.vectors import from_angles, to_angles, unit

if TYPE_CHECKING:
    from pipeline.physics.positions.distortion import Distortion

Array = NDArray[np.float64]

_WANTED_RESIDUAL_PX = 1e-5
_SIP_ORDERS = (2, 3, 4)
_SIP_ORDERS_DISTORTED = tuple(range(2, 10))
_EDGE_POINTS = 129  # of each side of the frame, where extremes of a distorted camera are looked for


@dataclass(frozen=True)
class Camera:
    """A gnomonic camera, undistorted unless it has a `distortion`.

    Pixel (0, 0) is the centre of the first pixel; the boresight meets the focal plane at
    x = (columns - 1)/2, y = (rows - 1)/2. An attitude is a (3, 3) matrix whose rows are the
    camera's +x (columns), +y (rows) and boresight axes in ICRS. At roll 0 +y points north and +x
    WEST, so that the picture shows the sky as seen from inside (east left): the three axes are
    left-handed and the determinant is -1. The distortion leaves the boresight where it is.
    charge_px_s : speed along +y of the charge that collects the light (TDI); what is drawn stands
    where its charge stands at mid-exposure.
    line_s : how much later each row is exposed than the one before (rolling shutter); negative:
    than the one after
    """

    rows: int
    columns: int
    pixel_pitch_m: float
    focal_length_m: float
    distortion: Distortion | None = None
    charge_px_s: float = 0.0
    line_s: float = 0.0

    @property
    def centre_px(self) -> tuple[float, float]:
        """Pixel coordinates (x, y) of the boresight."""
        return (self.columns - 1) / 2.0, (self.rows - 1) / 2.0


def ifov_rad(camera: Camera) -> float:
    """Side of an undistorted central pixel on the sky [rad]; also the tangent of one pixel."""
    return camera.pixel_pitch_m / camera.focal_length_m


def corner_radius(camera: Camera) -> float:
    """Angle from the boresight to the outer corner of the focal plane [rad].

    With a distortion: to the farthest place of its edge, and up to half an edge's step farther.
    """
    half_diagonal_px = 0.5 * np.hypot(camera.rows, camera.columns)
    if camera.distortion is not None:
        u, v = _edge(camera)
        far_u, far_v = camera.distortion.to_plane(u, v)
        step = np.hypot(np.diff(far_u), np.diff(far_v)).max()
        half_diagonal_px = np.hypot(far_u, far_v).max() + 0.5 * step
    return float(np.arctan(half_diagonal_px * ifov_rad(camera)))


def stretch(camera: Camera) -> float:
    """Most by which the distortion changes a length, either way and off the frame too; else 1.

    A place n px from another lies within n * stretch * ifov_rad of it on the sky; n undistorted
    pixels are at most n * stretch pixels of the detector.
    """
    if camera.distortion is None:
        return 1.0
    return camera.distortion.largest_stretch()


def off_axis_cosine(camera: Camera, x_px: Array, y_px: Array) -> Array:
    """Cosine (...) of the angle between lines of sight at pixels x, y (...) and the optical axis.

    The distortion is undone first. It is the entrance pupil's projected area over its own, and so
    the fraction of an axial source's light that the pupil takes in from there.
    """
    x0, y0 = camera.centre_px
    u, v = np.asarray(x_px, float) - x0, np.asarray(y_px, float) - y0
    if camera.distortion is not None:
        u, v = camera.distortion.to_plane(u, v)
    return np.asarray(1.0 / np.sqrt(1.0 + (u * u + v * v) * ifov_rad(camera) ** 2))


def solid_angle_sr(camera: Camera, x_px: Array, y_px: Array) -> Array:
    """Solid angle (n,) of the sky that pixels at x, y (n,) look at.

    `ifov_rad`^2 cos^3 of the angle off axis (gnomonic; Calabretta & Greisen 2002, section 5.1.3)
    times the determinant of the distortion's map to the tangent plane.
    """
    cosine = off_axis_cosine(camera, x_px, y_px)
    area = ifov_rad(camera) ** 2 * cosine * cosine * cosine
    if camera.distortion is not None:
        x0, y0 = camera.centre_px
        area = area * np.linalg.det(camera.distortion.scale_matrices(x_px - x0, y_px - y0))
    return np.asarray(area)


def project(camera: Camera, attitude: Array, u: Array) -> tuple[Array, Array]:
    """Pixel coordinates x, y (n,) of directions u (n, 3); NaN behind the camera.

    x = x0 + (u.x)/(u.b)/ifov: gnomonic (TAN; Calabretta & Greisen 2002, section 5.1.3), then moved
    by the distortion. Written without matrix products, so that a star's pixel does not depend on
    its neighbours in the array.
    """
    a, u = np.asarray(attitude, float), np.asarray(u, float)
    cx, cy, cz = (u[..., 0] * r[0] + u[..., 1] * r[1] + u[..., 2] * r[2] for r in a)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = np.where(cz > 0.0, 1.0 / (cz * ifov_rad(camera)), np.nan)
        x0, y0 = camera.centre_px
        if camera.distortion is not None:
            du, dv = camera.distortion.to_detector(cx * scale, cy * scale)
            return x0 + du, y0 + dv
        return x0 + cx * scale, y0 + cy * scale


def deproject(camera: Camera, attitude: Array, x_px: Array, y_px: Array) -> Array:
    """Unit vectors (n, 3) of pixel coordinates x, y (n,): the inverse of `project`."""
    a, step = np.asarray(attitude, float), ifov_rad(camera)
    x0, y0 = camera.centre_px
    du, dv = np.asarray(x_px, float) - x0, np.asarray(y_px, float) - y0
    if camera.distortion is not None:
        du, dv = camera.distortion.to_plane(du, dv)
    tx, ty = du[..., None] * step, dv[..., None] * step
    return unit(a[2] + tx * a[0] + ty * a[1])


@dataclass(frozen=True)
class WcsFit:
    """A FITS TAN or TAN-SIP world coordinate system.

    crval_deg (2,), crpix (2,) 1-based, cd_deg (2, 2); sip_a, sip_b (order + 1, order + 1) with
    [p, q] the coefficient of u^p v^q (u, v = pixel - crpix), sip_order 0 for plain TAN;
    residual_px: largest distance between the fit and the camera on an independent grid.
    """

    crval_deg: Array
    crpix: Array
    cd_deg: Array
    sip_order: int
    sip_a: Array
    sip_b: Array
    residual_px: float


def fit_wcs(camera: Camera, to_world: Callable[[Array, Array], Array]) -> WcsFit:
    """Fit the FITS WCS of a frame: TAN, with SIP where TAN alone leaves over 1e-5 px.

    Parameters
    ----------
    camera : gives the frame and its centre, where the projection is anchored.
    to_world : pixel coordinates x, y (n,) -> astrometric unit vectors (n, 3) in ICRS.

    The SIP polynomials (Shupe et al. 2005, ADASS XIV) take up what is no linear map of the tangent
    plane: differential aberration (7 arcsec over 20 degrees), refraction, distortion. Orders 2 to 4
    (to 9 for a camera with a distortion) are tried, and the lowest that meets the bound is taken.
    """
    x0, y0 = camera.centre_px
    u, v = frame_grid(camera, 21, 0.0)
    check_u, check_v = frame_grid(camera, 16, 0.02)
    places = [np.concatenate(both) for both in (([0.0], u, check_u), ([0.0], v, check_v))]
    seen = to_world(x0 + places[0], y0 + places[1])
    lon, lat = to_angles(seen[0])
    plane = TangentPlane(float(lon), float(lat))
    world, check_world = np.split(plane.project(seen[1:]), [u.size])
    fit = None
    orders = _SIP_ORDERS if camera.distortion is None else _SIP_ORDERS_DISTORTED
    for order in (1, *orders):
        cd, a, b = _fit_polynomial(u, v, world, order)
        inverse = np.linalg.inv(cd)
        focal = check_world @ inverse.T
        du = check_u + _evaluate(a, check_u, check_v) - focal[:, 0]
        dv = check_v + _evaluate(b, check_u, check_v) - focal[:, 1]
        fit = WcsFit(
            crval_deg=np.degrees([float(lon), float(lat)]),
            crpix=np.array([x0 + 1.0, y0 + 1.0]),
            cd_deg=np.degrees(cd),
            sip_order=order if order > 1 else 0,
            sip_a=a,
            sip_b=b,
            residual_px=float(np.max(np.hypot(du, dv))),
        )
        if fit.residual_px <= _WANTED_RESIDUAL_PX:
            break
    assert fit is not None
    return fit


def wcs_header(fit: WcsFit) -> dict[str, str | int | float]:
    """FITS keywords of a fit; LONPOLE is written out because its default differs at the pole."""
    projection = "TAN-SIP" if fit.sip_order else "TAN"
    header = tan_keywords(fit.crval_deg, fit.crpix, fit.cd_deg, projection)
    for name, table in (("A", fit.sip_a), ("B", fit.sip_b)):
        if not fit.sip_order:
            break
        header[f"{name}_ORDER"] = fit.sip_order
        for p in range(fit.sip_order + 1):
            for q in range(fit.sip_order + 1 - p):
                if p + q >= 2:
                    header[f"{name}_{p}_{q}"] = float(table[p, q])
    return header


@dataclass(frozen=True)
class TangentPlane:
    """The plane that touches the sphere at a longitude and latitude [rad]; (east, north) axes."""

    lon_rad: float
    lat_rad: float

    @property
    def east(self) -> Array:
        return np.array([-np.sin(self.lon_rad), np.cos(self.lon_rad), 0.0])

    @property
    def north(self) -> Array:
        s = np.sin(self.lat_rad)
        ca, sa = np.cos(self.lon_rad), np.sin(self.lon_rad)
        return np.array([-s * ca, -s * sa, np.cos(self.lat_rad)])

    def project(self, u: Array) -> Array:
        """Tangent-plane coordinates (n, 2) east, north [rad] of directions (n, 3)."""
        centre = from_angles(np.array(self.lon_rad), np.array(self.lat_rad))
        return np.stack([u @ self.east, u @ self.north], axis=-1) / (u @ centre)[:, None]


def _edge(camera: Camera) -> tuple[Array, Array]:
    """Offsets u, v (n,) from the centre all around the outer edge of the frame, in order."""
    along = np.linspace(-0.5, 0.5, _EDGE_POINTS)
    one = np.full(_EDGE_POINTS, 0.5)
    u = np.concatenate([along, one, -along, -one]) * camera.columns
    v = np.concatenate([-one, along, one, -along]) * camera.rows
    return u, v


def frame_grid(camera: Camera, side: int, shift: float) -> tuple[Array, Array]:
    """Pixel offsets u, v (side^2,) from the centre: Chebyshev points, the outer edge included."""
    nodes = np.cos(np.pi * (np.arange(side) + shift) / (side - 1 + 2 * shift))
    u, v = np.meshgrid(0.5 * camera.columns * nodes, 0.5 * camera.rows * nodes)
    return u.ravel(), v.ravel()


def _fit_polynomial(u: Array, v: Array, world: Array, order: int) -> tuple[Array, Array, Array]:
    """Least squares world = CD (offset + SIP(offset)): CD [rad/px] (2, 2), A, B tables."""
    scale = float(np.max(np.abs(np.concatenate([u, v])))) or 1.0
    powers = [(p, d - p) for d in range(1, order + 1) for p in range(d, -1, -1)]
    design = np.stack([(u / scale) ** p * (v / scale) ** q for p, q in powers], axis=-1)
    solution = np.linalg.lstsq(design, world, rcond=None)[0]
    cd: Array = np.asarray(solution[:2].T / scale, float)
    table = np.zeros((2, order + 1, order + 1))
    if order > 1:
        terms = np.linalg.solve(cd, solution[2:].T)
        for (p, q), term in zip(powers[2:], terms.T, strict=True):
            table[:, p, q] = term / scale ** (p + q)
    return cd, table[0], table[1]


def _evaluate(table: Array, u: Array, v: Array) -> Array:
    return np.asarray(np.polynomial.polynomial.polyval2d(u, v, table))


def tan_keywords(
    crval_deg: Array, crpix: Array, cd_deg: Array, projection: str
) -> dict[str, str | int | float]:
    """FITS keywords of a WCS about a zenithal `projection` (TAN, TAN-SIP, TPV), without suffix."""
    return {
        "WCSAXES": 2,
        "CTYPE1": f"RA---{projection}",
        "CTYPE2": f"DEC--{projection}",
        "CUNIT1": "deg",
        "CUNIT2": "deg",
        "CRVAL1": float(crval_deg[0]),
        "CRVAL2": float(crval_deg[1]),
        "CRPIX1": float(crpix[0]),
        "CRPIX2": float(crpix[1]),
        "CD1_1": float(cd_deg[0, 0]),
        "CD1_2": float(cd_deg[0, 1]),
        "CD2_1": float(cd_deg[1, 0]),
        "CD2_2": float(cd_deg[1, 1]),
        "LONPOLE": 180.0,
        "LATPOLE": float(crval_deg[1]),
        "RADESYS": "ICRS",
    }
