"""Distorted cameras against astropy.wcs and formulas; nothing far away folds into the frame."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
from astropy.io.fits import Header
from astropy.wcs import WCS
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.errors import BadInput
from pipeline.physics.constants import SPEED_OF_LIGHT_M_S
from pipeline.physics.motion.pointing import boresight_frame, proper_attitude
from pipeline.physics.positions.apparent import aberrate, unaberrate
from pipeline.physics.positions.apparent_wcs import apparent_wcs_header
from pipeline.physics.positions.distortion import (
    TPV_ODD,
    TPV_TERMS,
    Distortion,
    _covers,
    distortion_of,
    fitted,
    radial,
    sip,
)
from pipeline.physics.positions.focal_plane import (
    Camera,
    corner_radius,
    deproject,
    fit_wcs,
    ifov_rad,
    off_axis_cosine,
    project,
    solid_angle_sr,
    stretch,
    wcs_header,
)
from pipeline.physics.vectors import from_angles, separation, to_angles

CAMERA = Camera(rows=1500, columns=2048, pixel_pitch_m=10e-6, focal_length_m=0.15)  # 8 x 6 degrees
SIP = {
    "kind": "sip",
    "a": {"2_0": 3e-6, "1_1": -2e-6, "3_0": 4e-9, "1_2": 4e-9, "0_4": 1e-13},
    "b": {"0_2": 2e-6, "0_3": 4e-9, "2_1": 4e-9},
}
RADIAL = {"kind": "radial", "k1": -0.2, "k2": 0.05, "k3": 0.01, "p1": 1e-3, "p2": -5e-4}
TPV = {"kind": "tpv", "pv1": {1: 1.01, 2: 0.002, 4: 1e-3, 7: 3e-5, 9: 3e-5},
       "pv2": {1: 0.995, 5: -1e-3, 7: 3e-5, 9: 3e-5, 21: 1e-6}}  # fmt: skip
ALL = pytest.mark.parametrize("wish", [SIP, RADIAL, TPV], ids=["sip", "radial", "tpv"])
BETA = np.array([0.6, -0.7, 0.3]) * 30.5e3 / SPEED_OF_LIGHT_M_S


def distorted(wish: dict, camera: Camera = CAMERA) -> Camera:
    d = distortion_of(wish, camera.rows, camera.columns, ifov_rad(camera))
    return replace(camera, distortion=d)


def look(ra_deg: float, dec_deg: float, roll: float = 0.0) -> np.ndarray:
    return boresight_frame(from_angles(*np.radians([ra_deg, dec_deg])), roll)


def random_pixels(camera: Camera, n: int = 400, beyond: float = 0.5) -> tuple[np.ndarray, ...]:
    rng = np.random.Generator(np.random.SFC64(8))
    return (rng.uniform(-beyond, camera.columns - 1 + beyond, n),
            rng.uniform(-beyond, camera.rows - 1 + beyond, n))  # fmt: skip


def apart_px(camera: Camera, a: np.ndarray, b: np.ndarray) -> float:
    return float(np.max(separation(a, b))) / ifov_rad(camera)


def slopes_by_steps(camera: Camera) -> np.ndarray:
    """Slopes (2, 2) of a distortion at one place, which small steps from it confirm."""
    slopes, step = camera.distortion.scale_matrices(np.array([100.0]), np.array([-300.0]))[0], 1e-3
    for axis in (0, 1):
        du, dv = step * np.eye(2)[axis]
        ends = [camera.distortion.to_plane(np.array([100 + s * du]), np.array([-300 + s * dv]))
                for s in (1, -1)]  # fmt: skip
        numeric = (np.array(ends[0]) - ends[1])[:, 0] / (2 * step)
        assert slopes[:, axis] == pytest.approx(numeric, abs=1e-8)
    return slopes


def test_against_astropy_sip() -> None:
    """The convention, its sign and its order, through all_pix2world and sip_pix2foc."""
    attitude, camera = look(30.0, 40.0, 0.7), distorted(SIP)
    cards = apparent_wcs_header(CAMERA, attitude)
    cards |= {"CTYPE1": "RA---TAN-SIP", "CTYPE2": "DEC--TAN-SIP", "A_ORDER": 4, "B_ORDER": 3}
    cards |= {f"A_{k}": v for k, v in SIP["a"].items()}
    cards |= {f"B_{k}": v for k, v in SIP["b"].items()}
    wcs = WCS(Header(cards))
    x, y = random_pixels(camera)
    u = deproject(camera, attitude, x, y)
    assert apart_px(camera, u, from_angles(*np.radians(wcs.all_pix2world(x, y, 0)))) < 1e-8
    assert apart_px(camera, u, deproject(CAMERA, attitude, x, y)) > 5.0
    lon, lat = to_angles(u)
    back = wcs.all_world2pix(np.degrees(lon), np.degrees(lat), 0, tolerance=1e-10)
    found = project(camera, attitude, u)
    assert np.abs(np.array(back) - found).max() < 1e-7
    x0, y0 = camera.centre_px
    plane = camera.distortion.to_plane(x - x0, y - y0)
    foc = wcs.sip.pix2foc(np.stack([x, y], -1), 0)
    assert np.abs(np.array(plane) - (foc - foc.mean(0) + np.mean(plane, 1)).T).max() < 1e-8


@pytest.mark.parametrize("term", range(1, 40))
def test_against_astropy_tpv(term: int) -> None:
    """Each term alone, on both axes, for a rolled CD matrix and for the default at roll 0."""
    degree = TPV_TERMS[term][0] + max(TPV_TERMS[term][1], 0)
    size = 0.02 * 5.0 ** (1 - degree)
    for roll, cd in ((0.0, None), (0.4, "header")):
        attitude = look(30.0, -70.0, roll)
        cards = apparent_wcs_header(CAMERA, attitude)
        wish = {"kind": "tpv", "pv1": {term: size + (term == 1)}, "pv2": {term: -size}}
        if term == 1:
            wish["pv2"][1] = 1.0 - size
        if cd:
            wish["cd_deg"] = tuple(tuple(cards[f"CD{i}_{j}"] for j in (1, 2)) for i in (1, 2))
        camera = distorted(wish)
        cards |= {"CTYPE1": "RA---TPV", "CTYPE2": "DEC--TPV", "PV1_1": 1.0, "PV2_1": 1.0}
        cards |= {f"PV{i}_{term}": wish[f"pv{i}"][term] for i in (1, 2)}
        x, y = random_pixels(camera)
        there = from_angles(*np.radians(WCS(Header(cards)).all_pix2world(x, y, 0)))
        u = deproject(camera, attitude, x, y)
        assert apart_px(camera, u, there) < 1e-8
        assert apart_px(camera, u, deproject(CAMERA, attitude, x, y)) > 1.0
        slopes_by_steps(camera)


def test_tpv_terms_are_the_registry_s() -> None:
    assert len(TPV_TERMS) == 40
    assert TPV_ODD == (3, 11, 23, 39)
    assert (TPV_TERMS[5], TPV_TERMS[14], TPV_TERMS[38]) == ((1, 1), (2, 2), (0, 7))


def test_against_the_formula_radial() -> None:
    """From the direction to the pixel, term by term."""
    camera = distorted(RADIAL)
    step, (x0, y0) = ifov_rad(camera), camera.centre_px
    k1, k2, k3, p1, p2 = (RADIAL[n] for n in ("k1", "k2", "k3", "p1", "p2"))
    x, y = np.random.Generator(np.random.SFC64(2)).uniform(-0.05, 0.05, (2, 300))
    r2 = x * x + y * y
    shrink = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    wanted = (x * shrink + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
              y * shrink + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y)  # fmt: skip
    found = project(camera, np.eye(3), np.stack([x, y, np.ones(300)], -1))
    assert np.abs(found[0] - x0 - wanted[0] / step).max() < 1e-9
    assert np.abs(found[1] - y0 - wanted[1] / step).max() < 1e-9


@ALL
def test_there_and_back_near_and_far(wish: dict) -> None:
    camera, attitude = distorted(wish), look(200.0, -10.0, 0.3)
    for beyond in (0.5, 100.0, 300.0, 5e3):
        x, y = random_pixels(camera, 2000, beyond)
        back = project(camera, attitude, deproject(camera, attitude, x, y))
        assert np.hypot(back[0] - x, back[1] - y).max() < 1e-9
    u, v = np.random.Generator(np.random.SFC64(2)).uniform(-1e6, 1e6, (2, 2000))
    ways = Distortion.to_plane, Distortion.to_detector
    for one, other in (ways, ways[::-1]):
        back = other(camera.distortion, *one(camera.distortion, u, v))
        assert np.hypot(back[0] - u, back[1] - v).max() < 2e-9


coefficient = st.floats(-1.0, 1.0)


@settings(max_examples=60)
@given(st.lists(coefficient, min_size=24, max_size=24), st.floats(-900, 900), st.booleans())
def test_same_place_there_and_back_any_polynomial(
    draws: list[float], reference: float, to_pixel: bool
) -> None:
    powers = [(p, d - p) for d in (2, 3, 4) for p in range(d + 1)]
    a, b = (
        {
            f"{p}_{q}": 0.03 * c * 1200.0 ** (1 - p - q)
            for (p, q), c in zip(powers, some, strict=True)
        }
        for some in (draws[:12], draws[12:])
    )
    raw = replace(sip(a, b, (reference, -0.5 * reference)), to_pixel=to_pixel)
    try:
        d = fitted(raw, 1500, 2048)
    except BadInput:
        return
    u, v = np.random.Generator(np.random.SFC64(3)).uniform(-3000, 3000, (2, 500))
    back = d.to_detector(*d.to_plane(u, v))
    assert np.hypot(back[0] - u, back[1] - v).max() < 1e-9
    middle = d.to_plane(np.zeros(1), np.zeros(1))
    assert np.abs(middle).max() < 1e-9
    # Strongly monotone: two places never come closer than the least slope allows.
    x, y = d.to_plane(u, v) if not to_pixel else d.to_detector(u, v)
    along = np.diff(u) * np.diff(x) + np.diff(v) * np.diff(y)
    assert (along > 0.045 * (np.diff(u) ** 2 + np.diff(v) ** 2)).all()


@ALL
def test_same_bits_alone_and_among_others(wish: dict) -> None:
    camera, attitude = distorted(wish), look(30.0, 40.0, 0.2)
    x, y = random_pixels(camera, 1001, 400.0)
    u = deproject(camera, attitude, x, y)
    found = project(camera, attitude, u)
    u[3] = np.nan
    for i in (0, 1, 500, 1000):
        one = project(camera, attitude, u[i : i + 1])
        assert (one[0][0], one[1][0]) == (found[0][i], found[1][i])
    shuffled = project(camera, attitude, u[::-1])
    assert np.isnan(shuffled[0][-4])
    assert np.array_equal(shuffled[0][::-1][4:], found[0][4:])


@ALL
def test_limits_only_what_the_frame_sees_is_in_it(wish: dict) -> None:
    """Directions over the whole sky: what lands in the frame is what its pixels look at."""
    camera, attitude = distorted(wish), look(30.0, 40.0)
    rng = np.random.Generator(np.random.SFC64(4))
    u = rng.normal(size=(400_000, 3))
    u /= np.linalg.norm(u, axis=1)[:, None]
    x, y = project(camera, attitude, u)
    inside = (np.abs(x - 1023.5) <= 1024) & (np.abs(y - 749.5) <= 750)
    assert inside.sum() > 100
    assert separation(u[inside], attitude[2]).max() < corner_radius(camera)
    assert apart_px(camera, deproject(camera, attitude, x[inside], y[inside]), u[inside]) < 1e-9
    behind = u @ attitude[2] < 0
    assert np.isnan(x[behind]).all()


def test_limits_star_at_60_degrees_is_not_folded_in() -> None:
    """1 + k1 r^2 is 0 at tan 61 degrees: the bare polynomial would draw that star in the middle."""
    camera, attitude = distorted({**RADIAL, "k1": -0.3, "k2": 0, "k3": 0}), look(0.0, 0.0)
    off = np.radians(np.linspace(5.0, 89.9, 300))
    r = np.tan(off)
    bare = r * (1 - 0.3 * r**2) / ifov_rad(camera)
    assert np.abs(bare[(off > np.radians(55)) & (off < np.radians(65))]).min() < 500
    for angle in (0.0, 0.7, 2.0):
        side = np.cos(angle) * attitude[0] + np.sin(angle) * attitude[1]
        u = np.cos(off)[:, None] * attitude[2] + np.sin(off)[:, None] * side
        x, y = project(camera, attitude, u)
        distance = np.hypot(x - 1023.5, y - 749.5)
        assert (np.diff(distance) > 0).all()
        assert np.abs(distance - r / ifov_rad(camera)).max() < 40.0
        assert distance[off > np.radians(59)].min() > 20_000


@pytest.mark.parametrize(
    ("wish", "where"),
    [
        ({"kind": "sip", "a": {"3_0": -4e-7}, "b": {}}, "x = "),
        ({"kind": "sip", "a": {"2_0": 6e-4}, "b": {}}, "x = -"),
        ({"kind": "sip", "a": {"0_9": 1e29}, "b": {}}, "x = "),
        ({"kind": "tpv", "pv1": {1: -1.0}, "pv2": {}}, "slope of -1"),
        ({"kind": "tpv", "pv1": {}, "pv2": {1: 0.01}}, "slope of 0.01"),
        ({"kind": "radial", "k1": -200.0, "k2": 0, "k3": 0, "p1": 0, "p2": 0}, "towards pixel"),
        ({"kind": "radial", "k1": -0.0262, "k2": 3.3e-4, "k3": 0, "p1": 0, "p2": 0,
          "reference_px": (69000.0, 750.0)}, "light that does not reach the frame's edge"),
    ],
)
def test_limits_folds_are_refused(wish: dict, where: str) -> None:
    with pytest.raises(BadInput, match="one-to-one") as caught:
        distorted(wish)
    assert caught.value.field == "sensor.distortion"
    assert where in str(caught.value)


def test_limits_fold_is_named_where_it_is() -> None:
    """u + A u^2 turns at u = -1 / (2 A): 900 px left of the middle."""
    with pytest.raises(BadInput, match=r"x = -\d") as caught:
        distorted({"kind": "sip", "a": {"2_0": 1 / 1800}, "b": {}})
    assert "slope of -" in str(caught.value)
    distorted({"kind": "sip", "a": {"2_0": 1 / 2800}, "b": {}})


@ALL
def test_limits_displacement_fades_smoothly(wish: dict) -> None:
    """Exact to the margin, twice differentiable at its edge, constant far away."""
    d = distorted(wish).distortion
    edge = d.half_px[0]
    plane = replace(d, to_pixel=False)
    u = np.linspace(edge - 40, edge + 40, 8001)
    moved = plane.to_plane(u, np.full(u.shape, 200.0))[0] - u
    bare = replace(plane, half_px=(1e9, 1e9))
    exact = bare.to_plane(u, np.full(u.shape, 200.0))[0] - u
    within = u <= edge
    assert np.array_equal(moved[within], exact[within])
    assert np.abs(np.diff(moved, 2)).max() < 1e-4
    far = plane.to_plane(np.array([3e4, 6e4]), np.array([200.0, 200.0]))[0]
    assert far[1] - far[0] == pytest.approx(3e4, abs=1e-7)


@ALL
def test_corner_radius_and_stretch_hold(wish: dict) -> None:
    camera, attitude = distorted(wish), look(10.0, 5.0)
    n = np.linspace(-0.5, 0.5, 3001)
    x = np.concatenate([n * 2048, n * 2048, 0 * n + 1024, 0 * n - 1024]) + 1023.5
    y = np.concatenate([0 * n + 750, 0 * n - 750, n * 1500, n * 1500]) + 749.5
    angle = separation(deproject(camera, attitude, x, y), attitude[2]).max()
    assert angle <= corner_radius(camera) < angle + 12 * ifov_rad(camera)
    x, y = random_pixels(camera, 20_000, 400.0)
    u = deproject(camera, attitude, x, y)
    apart = separation(u[1:], u[:-1])
    bound = np.hypot(np.diff(x), np.diff(y)) * stretch(camera) * ifov_rad(camera)
    assert (apart <= bound * (1 + 1e-9)).all()
    near = deproject(camera, attitude, x + 0.1, y)
    assert (separation(u, near) <= 0.1 * stretch(camera) * ifov_rad(camera) * (1 + 1e-6)).all()
    assert stretch(CAMERA) == 1.0
    plain = project(CAMERA, attitude, u)
    bound = np.hypot(np.diff(plain[0]), np.diff(plain[1])) * stretch(camera)
    assert (np.hypot(np.diff(x), np.diff(y)) <= bound * (1 + 1e-9)).all()


def _solid_angles(camera: Camera, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Of pixels, from the directions of their corners: two triangles each (Van Oosterom)."""
    h, attitude = 0.5, look(0.0, 0.0)
    corners = [(-h, -h), (h, -h), (h, h), (-h, h)]
    a, b, c, d = (deproject(camera, attitude, x + dx, y + dy) for dx, dy in corners)

    def triangle(p, q, r):
        top = np.einsum("ij,ij->i", p, np.cross(q - p, r - p))
        low = 1 + np.sum(p * q, -1) + np.sum(q * r, -1) + np.sum(r * p, -1)
        return 2 * np.arctan2(np.abs(top), low)

    return triangle(a, b, c) + triangle(a, c, d)


@ALL
def test_solid_angle_of_pixels(wish: dict) -> None:
    camera = distorted(wish)
    x, y = (g.ravel() for g in np.meshgrid(np.linspace(0, 2047, 33), np.linspace(0, 1499, 33)))
    found = solid_angle_sr(camera, x, y)
    np.testing.assert_allclose(found, _solid_angles(camera, x, y), rtol=1e-6)
    axis = deproject(camera, np.eye(3), *(np.array([c]) for c in camera.centre_px))
    cosine = deproject(camera, np.eye(3), x, y) @ axis[0]
    np.testing.assert_allclose(off_axis_cosine(camera, x, y), cosine, rtol=1e-12)
    corner = off_axis_cosine(CAMERA, np.array([-0.5]), np.array([-0.5]))
    assert corner[0] == pytest.approx(np.cos(corner_radius(CAMERA)), rel=1e-12)
    slopes = slopes_by_steps(camera)
    assert camera.distortion.largest_stretch() >= np.linalg.norm(slopes, 2)


@ALL
@pytest.mark.parametrize("place", [(10.0, 20.0), (123.0, 90.0), (359.9999, -45.0)], ids=str)
def test_against_astropy_the_wcs_of_a_distorted_frame(
    wish: dict, place: tuple[float, float]
) -> None:
    """Aberration and distortion together: catalogue direction to pixel within 1e-5 px."""
    camera, sought = distorted(wish), look(*place, roll=-0.8)
    attitude = proper_attitude(sought, aberrate(sought[2], BETA))

    def to_world(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return unaberrate(deproject(camera, attitude, x, y), BETA)

    fit = fit_wcs(camera, to_world)
    assert fit.residual_px < 1e-5
    assert 2 <= fit.sip_order <= 9
    x, y = random_pixels(camera)
    lon, lat = to_angles(to_world(x, y))
    wcs = WCS(Header(wcs_header(fit)))
    px = wcs.all_world2pix(np.degrees(lon), np.degrees(lat), 0, tolerance=1e-9, maxiter=60)
    assert np.hypot(px[0] - x, px[1] - y).max() < 1.5e-5


def test_wide_lens_needs_the_high_orders() -> None:
    """An equidistant lens (r = f theta) of 40 degrees across, as a radial series."""
    camera = Camera(2000, 2000, 10e-6, 0.0275)
    wish = {"kind": "radial", "k1": -1 / 3, "k2": 1 / 5, "k3": -1 / 7, "p1": 0.0, "p2": 0.0}
    wide = distorted(wish, camera)
    attitude = look(40.0, 10.0)
    fit = fit_wcs(wide, lambda x, y: deproject(wide, attitude, x, y))
    assert fit.sip_order > 4
    assert fit.residual_px < 0.02
    edge = deproject(wide, attitude, np.array([1999.5]), np.array([999.5]))
    theta = float(separation(edge, attitude[2])[0])
    assert theta == pytest.approx(1000 * ifov_rad(wide), rel=1e-3)


def test_reference_pixel_off_the_frame_leaves_the_boresight() -> None:
    """A chip of a mosaic: the terms count from a far pixel, the pointing stays the scene's."""
    camera = distorted({**SIP, "reference_px": (-800.0, 1900.0)})
    attitude = look(77.0, 12.0)
    middle = deproject(camera, attitude, np.array([1023.5]), np.array([749.5]))
    assert separation(middle, attitude[2])[0] < 1e-14
    x, y = random_pixels(camera)
    raw = distorted(SIP).distortion
    bare = replace(raw, half_px=(1e9, 1e9))
    shift = np.array(bare.to_plane(x + 800, y - 1900)) - [x + 800, y - 1900]
    zero = np.array(bare.to_plane(np.array([1823.5]), np.array([-1150.5])))
    zero -= [[1823.5], [-1150.5]]
    found = np.array(camera.distortion.to_plane(x - 1023.5, y - 749.5)) - [x - 1023.5, y - 749.5]
    assert np.abs(found - (shift - zero)).max() < 1e-8


def test_frozen_hashable_picklable() -> None:
    camera = distorted(SIP)
    again = pickle.loads(pickle.dumps(camera))
    assert again == camera
    assert hash(again) == hash(camera)
    assert distorted(SIP).distortion is camera.distortion
    assert isinstance(camera.distortion, Distortion)
    assert CAMERA.distortion is None


def test_no_terms_move_nothing() -> None:
    for wish in ({"kind": "sip", "a": {}, "b": {}}, {"kind": "tpv", "pv1": {}, "pv2": {}}):
        camera = distorted(wish)
        x, y = random_pixels(camera, 50, 900.0)
        u = deproject(CAMERA, look(1.0, 2.0), x, y)
        found = project(camera, look(1.0, 2.0), u)
        assert np.abs(np.array(found) - project(CAMERA, look(1.0, 2.0), u)).max() < 1e-12
        assert stretch(camera) == pytest.approx(1.01)
    one = distortion_of(SIP, 1, 1, 1e-5)
    assert one.half_px == (4.5, 4.5)
    straight = fitted(radial((0.0,) * 3, (0.0, 0.0), 1e-5), 10, 10)
    assert straight.to_detector(np.array([4.0]), np.array([-2.0])) == (4.0, -2.0)


@pytest.mark.parametrize(("a", "b", "half_px", "covered"), [
    ({}, {}, (29.0, 19.0), True), ({}, {}, (25.0, 5.0), True), ({}, {}, (5.0, 25.0), False),
    ({"1_0": -0.5}, {}, (16.0, 5.0), False), ({}, {"0_1": -0.5}, (5.0, 12.0), False),
    ({"2_0": 0.005}, {}, (28.0, 5.0), False), ({"0_2": 0.005}, {}, (27.5, 5.0), True),
    ({"0_2": 0.005}, {}, (28.5, 5.0), False),
])  # fmt: skip
def test_a_rectangle_covers_what_its_image_lies_around(
    a: dict[str, float], b: dict[str, float], half_px: tuple[float, float], covered: bool
) -> None:
    """One of 60 px by 40 that is not moved, shrunk along an axis, pushed to a side by up to 4.5 px,
    or bent: the middles of two sides stay while their ends are pushed by 2 px."""
    d = replace(sip(a, b), to_pixel=True, half_px=(30.0, 20.0))
    assert _covers(d, half_px) == covered
