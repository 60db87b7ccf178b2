"""Noise, cosmic rays, motion, meshes and detection at edge values: what each function gives."""

from __future__ import annotations

import dataclasses
import functools
import importlib
from typing import Any

import numpy as np
import pytest

from pipeline.physics.vectors import unit
from tests.pins.test_told_studies import told_lines
from tests.pins.told import check_told

MODULES = {
    "noise": "streams terms chain converter patterns pixel_draws joint wells transfer",
    "detection": "",
    "cosmic_rays": "tracks frame library deposit detect straggling",
    "motion": "streak linear_system attitude_table pointing rolling disturbance jitter flexible",
    "meshes": "model bins light_table lamps facets brdf_table brdf intensity shells",
}
CASES = {
    "noise": """
key = streams.stream_key(7, "photon_noise")
key, streams.stream_key(-1, ""), streams.uniform(0, 0), streams.uniform(2**32 - 1, 2**32 - 1)
streams.uniforms(2, 3, 5, 1, 4, *key), streams.standard_normals(2, 520, 3, 7, 1, *key)
[pixel_draws.normal_quantile(p) for p in (1e-300, 1e-12, .01, .074, .076, .5, .925, .93, 1 - 1e-16)]
[pixel_draws.inverted_poisson(m, u) for m in (-1., 0., 1e-9, 3., 9.99) for u in (1e-9, .5, 1 -
    1e-16)]
[pixel_draws.gaussian_poisson(m, u) for m in (1.1e8, 1e14) for u in (1e-9, .5, .9)]
[pixel_draws._log_pmf(k, m) for k, m in ((0., 30.), (6., 30.), (7., 30.), (60., 30.), (12., 12.))]
[pixel_draws.accepted(k, 20., us, v) for k in (-1., 3., 20., 60.) for us in (.01, .02, .4) for v in
    (.005, .02, .9)]
[streams.poisson(m, 3, 4, f, *key) for m in (0., 2., 9.99, 10., 50., 1e8, 2e8) for f in range(4)]
streams.poisson_image(np.tile(np.geomspace(1e-3, 1e9, 530), (3, 1)), 2, 1, 0, *key)
[streams.poisson_image(np.full((2, 530), m), 2, 1, 0, *key) for m in (4.5, 11., 45.)]
[joint.joint_quantile(z, m, r) for z in (-6., -1., 0., 4.) for m, r in ((0., 2.5), (10., 1.5), (1e6,
    3.))]
[bool(joint.serves(m, r)) for m in (0., 9.99, 10.) for r in (0., 1.49, 1.5, 2.49, 2.5)]
row, few = np.linspace(0, 40, 530)[None], np.full((1, 530), 3.)
joint.measured_image(np.repeat(row, 3, 0), few, few + 30, few / 3, 0, 3, 1, key, (1, 2), (3, 4))
few[0, :9] = 1.
joint.measured_image(np.repeat(row, 2, 0), np.repeat(row, 2, 0), few + 1e9, np.repeat(few, 2, 0), 0,
    4, 1, key, (1, 2), (3, 4))
place = terms.StreamPlace(2, 1, 3, (1, 2), (3, 4), (5, 6), (7, 8), (9, 10))
plain, e = terms.Chain(1., 0., None, 5., 1.5, 100., 16), np.linspace(0., 3e4, 600).reshape(3, 200)
chain.layers_e({"s": a(0, 1, 5)}, but(plain, flat=.5, dark_e=7.), (1, 3)), chain.to_dn(e, plain,
    place)
chain.to_dn(np.full((300, 300), 50.), but(plain, row_noise_e=4., column_noise_e=2.,
    gain_e_per_dn=np.full((300, 300), 2.)), place, np.full((300, 300), 9.))
chain.to_dn(e, but(plain, full_well_e=2e4, linearity=(a(0, 1e4, 2e4), a(0, 9e3, 1.5e4)),
    rounding="floor"), place)
chain.to_dn(e, but(plain, full_well_e=2e4, blooming=True, photon_noise=False, read_noise_e=0.),
    place, e)
chain.to_dn(e, but(plain, read_noise_e=0., bad=(np.array([1, 2]), np.array([5, 0]), np.array([7,
    65535]))), place)
chain.to_dn(e, but(plain, bias_dn=e, adc_bits=12, full_well_e=e, read_noise_e=e / 1e3), place)
chain.to_dn(a(-1e-9)[None], plain, place)
chain.to_dn(a(np.inf)[None], plain, place)
signal = a(-3, -.5, 0, .4, .5, 1.5, 2.5, 254.5, 255.4, 1e9, 2**40, 9.3e18)
[converter.digitise(signal.copy(), 0., bits, way) for bits in (1, 8, 40, 41, 63) for way in
    ("half_even", "floor")]
[converter.digitise(a(.5, 1.5, 2.75), b, 50, "half_even") for b in (-.25, .5, 2.**62)],
    converter.digitise(a(1), a(2**63), 63)
[str(converter.dn_type(b)) for b in (1, 8, 9, 16, 17, 32, 33, 63)]
converter._whole_and_rest(a(-1.25, 2**63, -2.**64))
converter._saturated_sum(np.array([2**63 - 1, -2**63, 5]), np.array([3, -3, 4]))
dn, table = np.array([[0, 100, 101], [500, 65535, 7]]), (a(0, 100, 300), a(10, 90, 200))
chain.calibrated_e(dn, plain), chain.calibrated_e(dn, but(plain, rounding="floor",
    dark_e=3., flat=.8))
chain.calibrated_e(dn, but(plain, flat=np.eye(2, 3), linearity=table, bad=(np.array([1]),
    np.array([1]), np.array([7]))))
patterns.prnu((3, 4), 7, 3.), [int(patterns.chosen((9, 9), 7, "hot", f).sum()) for f in (0., .3,
    1.)]
patterns.hot_dark_e_s((3, 4), 7, .5, 10., .5), patterns.bias_pattern_dn((3, 4), 7, 1., 2., 4., 10.,
    -20.), patterns.bias_pattern_dn((1, 2), 7, 0., 0., 0., 5., 1.)
c = np.array([[0, 0], [7, 0], [100, 90], [19, 0], [0, 0], [30, 0], [3, 0], [0, 0], [0, 99.]])
wells.bloom(c, np.full((9, 2), 20.)) or c
wells.measured_e(a(-5, 0, 5, 10, 15, 30), *table), wells.collected_e(a(-5, 1, 5, 90, 120, 15),
    *table)
light = a(*range(12)).reshape(4, 3)
[transfer.smear_e(light, s, .1, high, clear) for s in (0., 2.) for high in (True, False) for clear
    in (True, False)]
[transfer.lag_frames(f, e, 1.) for f in (.01, .1, .9) for e in (0., 1., 2., 1e3, 1e6)],
    transfer.lagged_e([light, 2 * light, 0 * light], .25)
[transfer.exposed_share(5, r, s) for r, s in ((0., 1.), (1., 2.), (-3., 1.), (100., 1.), (1e-9,
    1.))], transfer.passed_means(light, 1., 2.)
""",
    "detection": """
noisy = np.random.default_rng(1).normal(100., 5., (40, 30))
noisy[10:13, 8:11] += a(1, 2, 1, 2, 9, 2, 1, 2, 1).reshape(3, 3) * 8
psf = a(1, 2, 1, 2, 4, 2, 1, 2, 1.5).reshape(3, 3) / 16
s = it.filtered(noisy, psf)
it.robust_noise(noisy), it.robust_noise(np.ones((3, 3))), it.robust_noise(np.rint(noisy), 30.),
    it.robust_noise(a(0, 0, 0, 0, 1.49, 1.5, 1.51), .5)
s, it.filtered(noisy, psf[:2], 9.), it.filtered(np.ones((4, 5)), psf), it.filtered(noisy, 0 *
    psf).shape
it.peak_near(s, 9, 9, 3.), it.peak_near(s, 11, 8, 1.), it.peak_near(s, 30, 20, 0.), it.peak_near(s,
    0, 0, 1e9)
""",
    "cosmic_rays": """
flux = tracks.Flux(60, 80, 9., 100., 40., 50.)
ground = but(flux, zenith_power=2., helium_share=.3, delta_electrons=False, diffusion_um=0.)
[(f.margin_px, f.longest_um, deposit.reach_px(f), tracks.mean_count(f)) for f in (flux, ground,
    tracks.Flux(1, 1, 10., 10., 0., 1.))]
[tracks.angle_table(f) for f in (flux, ground)], tracks._in_plane_px(flux, a(1e-6, .1, .5, 1))
tracks._azimuths(a(0, 1, 50, 50, 50, 50, 1e4), 60., 80., a(.1, .9, .2, .4, .6, .8, .5), a(.1, .5,
    .01, .5, .7, .9, .999))
t = tracks.draw_tracks(flux, 3, (11, 12))
len(t), t, tracks.draw_tracks(ground, 0, (11, 12)), t.taken(np.array([0, 2])),
    len(tracks.draw_tracks(but(flux, integration_s=0.), 0, (1, 2)))
[int(deposit.touching(t, flux, *p).sum()) for p in ((0, 0, 60, 80), (50, 70, 10, 10), (0, 0, 1, 1),
    (2000, 0, 5, 5))]
[frame.charge_e(f, 7, 2, 0, 0, 60, 80) for f in (flux, ground, but(flux, diffusion_um=8.,
    rate_per_cm2_s=400.), but(flux, thickness_um=500.))], frame.charge_e(flux, 7, 2, 20, 30, 10, 12)
[frame.truth_columns(f, 7, 2) for f in (flux, ground)], frame.no_truth(), frame.exposed_for(flux,
    50.) is flux, frame.exposed_for(flux, 2.).integration_s
z, image = np.empty(999), np.zeros((4, 5))
[deposit.spread_point(image, np.array([10, 20, 4, 5]), z, x, y, s, 100.) for x, y, s in ((20., 10.,
    0.), (24.5, 13.4, .3), (22., 8., 2.), (19., 12., .1), (90., 12., .5), (22., 12., 30.))], image
[straggling.landau(u, v) for u in (1e-9, .1, .5, .9, 1 - 1e-9) for v in (1e-9, .5, .999)]
[(straggling.scale_ev(x, z), straggling.loss_ev(straggling.scale_ev(x, z), v)) for x in (0., 1.,
    300.) for z in (1., 2.) for v in (-3., -.22278, 50.)]
[straggling.electron_range_um(x) for x in (1e4, 3e4, 5e5, 2.5e6)],
    straggling.restricted_loss_ev_um(3e4, 2)
n = np.array([1, 4, 7, 2, 5, 3])
along, event = np.concatenate([np.arange(k) for k in n]), np.repeat(np.arange(6), n)
lib = library.Library(np.r_[0, np.cumsum(n)], np.minimum(3 + 4 * event + along, 31), np.minimum(2 +
    5 * event + along // 2, 31), 200. + 150. * event + 40. * along, 3., 1024, 9., (32, 32), 3,
    np.array([0, 0, 1, 1, 2, 2]))
none = but(lib, start=np.array([0]), x=lib.x[:0], y=lib.y[:0], electrons=lib.electrons[:0],
    frame=lib.frame[:0])
one = library.Recorded(lib, 40, 50, 9., 2.)
many = [one, but(one, pixel_pitch_um=18., rate_scale=3.), but(one, arrival="frames",
    rate_scale=1.7), but(one, arrival="frames", rows=20, columns=70), but(one, library=none),
    but(one, library=but(lib, pixel_pitch_um=None))]
len(lib), lib.rate_per_px_s, lib.boxes(), [(library.mean_count(r), library.expected_count(r),
    frame.events_a_frame(r)) for r in many]
[library.place_events(r, f, (5, 6)) for r in many for f in (0, 1)]
[frame.charge_e(r, 7, f, 0, 0, r.rows, r.columns) for r in many for f in (0, 1)],
    frame.charge_e(many[2], 7, 0, 10, 5, 9, 20)
[frame.truth_columns(r, 7, 1) for r in many[1:5]], [library._offsets(32, n) for n in (1, 31, 32, 33,
    64, 65)]
stack, good = np.random.default_rng(2).normal(50., 3., (7, 12, 12)).astype(np.float32),
    np.zeros((12, 12), bool)
stack[2, 4, 3:8] += a(9, 60, 90, 60, 9)
stack[5, 0, 0], stack[5, 1, 1] = 500., 70.
level, sigma = detect.stack_levels(stack)
level, sigma, detect.steady_sigma(sigma, 0.), detect.steady_sigma(sigma, 99.)
rest = detect.residual(stack[2] + 7, level)
rest, detect.bad_pixels(np.array([[0, 2, 3], [10, 11, 12]]), 100), detect.bad_pixels(np.array([2,
    3]), 5)
[detect.find_events(detect.residual(f, level), detect.steady_sigma(sigma, 0.), good, s, g) for f in
    stack[[2, 5]] for s, g in ((10., 3.), (5., 5.))]
good[4, 5] = True
detect.find_events(rest, detect.steady_sigma(sigma, 0.), good, 10., 2.), detect.find_events(0 *
    rest, sigma, good, 5., 3.)
""",
    "motion": """
line = streak.Path(a(0, 30, 250, 260), a(0, 40, -20, -20), a(.5, .3, .2))
line.segments, line.length_px, line == streak.Path(line.x_px, line.y_px, line.weight), line == 3,
    streak.POINT
[streak.path_through(a(0, 1, 2, 3, 4), y, w, tol) for y in (a(0, 0, 0, 0, 0), a(0, 1, 3, 6, 10)) for
    w in (a(.25, .25, .25, .25), a(0, 0, 1, 0), a(0, 0, 0, 0)) for tol in (0., .3)]
[streak.pieces(line, *more) for more in ((), (50., (0., 60., -5., 60.)), (20., (900., 901., 0.,
    1.)), (1e9,))]
streak.pieces(streak.Path(a(0, 1), a(0, 1), a(0))), streak.piece_counts(line)
streak.within(a(0, 0, 5, -9), a(0, 5, 5, 0), a(10, 0, 0, 1), a(10, 0, 1, 0), (2., 6., 1., 5.))
[streak.part_within(line, box) for box in ((-1., 300., -50., 99.), (10., 20., 0., 99.), (100., 110.,
    -50., 99.), (10., 200., 0., 99.), (900., 901., 0., 1.), (-1., 0., -1., 0.))]
[streak.sinc_of(h, np.sin(h)) for h in (1e-9, .049, .051, 3., -2.)], streak.transfer(a(-.5, 0, .1),
    a(0, .25, .5), line.x_px, line.y_px, line.weight)
stiff, push = np.array([[-1e-3, 0, 0], [1., -1., 0], [0, 1e5, -1e5]]), np.diag([.1, 1., 10.])
[linear_system.discretise(stiff, push, h) for h in (0., 1e-12, 1e-3, 1., 1e4)],
    linear_system.discretise(np.zeros((1, 1)), a(2)[None], 3.).doubled()
[linear_system.stationary_covariance(m, b) for m, b in ((stiff, push), (np.zeros((1, 1)),
    a(1)[None]), (np.array([[0, 1.], [-1., -.2]]), np.array([[0], [1.]])))]
[linear_system.factor(np.array(m)) for m in ([[4., 0], [0, 0]], [[4., 2.], [2., 1.]], [[4., 1.],
    [1., 9.]])]
[linear_system.bridge(linear_system.discretise(m, b, .5)) for m, b in ((stiff, push), (np.zeros((2,
    2)), np.diag([1., 0])))]
q = unit(a(0, 0, 0, 1, .1, 0, 0, 1, -.2, .1, 0, -1, .3, .2, 0, 1, 1, 0, 0, 0, 1, 0, .2, .1, 1, 0,
    .2, .1, 1, 1, 1, 1, 2, 1, 1, 1).reshape(9, 4))
tables = [attitude_table.AttitudeTable(a(*range(9)), q, how) for how in ("slerp", "spline")]
[attitude_table.attitudes_at(t, a(0, .3, 1, 2.5, 5.5, 7.999, 8)) for t in tables]
[attitude_table.table_error_rad(t, np.array(w, bool)) for t in tables for w in ([1] * 9, [0, 1] +
    [0] * 7, [1] + [0] * 8)]
[attitude_table.table_error_rad(but(t, time_s=a(0, 1, 2, 3), q=q[:4]), np.ones(4, bool)) for t in
    tables]
attitude_table.product(q[1], q[3]), attitude_table.conjugate(q[3]), attitude_table._angle(q[1:4],
    q[2:5]), attitude_table.matrix_of(q[3:4])
dirs = a(0, 0, 1, 0, 0, -1, 1, 0, 0, -1e-300, 0, 1, .3, -.4, .5).reshape(5, 3)
pointing.east_north(dirs), pointing.boresight_frame(dirs),
    pointing.boresight_frame(np.repeat(dirs[4:], 3, 0), [0., np.pi / 2, 7.])
pointing.drift(dirs[4], .1, -.2, [-1, 0, 2.]), pointing.drift(dirs[0], 0., .3, 1.),
    pointing.drift(dirs[2], 0., 0., [5.])
pointing.attitudes_drift(dirs[4], .3, .1, -.2, [-1, 2.]), pointing.attitudes_swept(dirs[4], .3, (.1,
    -.2), (.03, .02), [-1, 0, 2.])
pointing.attitudes_local(np.eye(3)[None], .7, .4, .2), pointing.attitudes_local(np.eye(3)[None], 0.,
    np.pi / 2, 0.)
pointing.proper_attitude(pointing.boresight_frame(dirs[4:]), unit(a(.31, -.4, .5)[None])),
    pointing.proper_attitude(np.eye(3)[None], dirs[:1])
pointing.proper_attitude(np.eye(3)[None], dirs[1:2])
when, y = a(0, .5, 1), np.array([[1, 2, 3.], [50, 55, 61], [90, 90, 90], [np.nan, 1, 2]])
[rolling.row_delay_s(a(-999, -1, 0, 5, 99, 999), s, 100) for s in (2e-3, 0., -2e-3)],
    rolling.later(y[:2], when, .1), rolling.later(y[:2], 0 * when, .1)
[rolling.rolled(y[::-1], y, when, s, 100) for s in (1e-3, -1e-3, .05)],
    rolling.rolled_sources(y[:3], y[:3], y[:3] + 1, y[:3] + 9, y[:3] / 99, when, 1e-2, 100)
disturbance.turned(np.repeat(np.eye(3)[None], 4, 0), a(0, 1e-9, .3, 0), a(0, 0, -.4, 3), a(0, 0, .1,
    3.2))
far = disturbance.rotation_of(a(0, 0, 0, 1e-12, 0, 0, .3, -.2, 3, 0, np.pi, 0).reshape(4, 3))
far, disturbance.rotation_vector(far), disturbance.quaternion_of(far),
    [disturbance.slewed(np.eye(3)[None], far[k : k + 1], a(0, .25, 1)) for k in (0, 2, 3)]
[disturbance.slew_share(a(-1, 0, 1, 4, 5, 9, 10, 11), 10., p) for p in ("minimum_jerk",
    "bang_bang")], [disturbance.settling(a(-1, 0, .1, .2, 9), 2., 1.3, z) for z in (0., .1, .99)]
spectra = [jitter.white(1e-5, .1, 100.), jitter.power_law(1e-5, 2., .1, 100.),
    jitter.resonance(1e-5, 12., .02), jitter.table(a(.1, 1, 10), a(3, 2, 0)), jitter.table(a(1, 2),
    a(0, 0))]
binned = [jitter.bins_of(s, 7.) for s in spectra]
[(s.low_hz, s.high_hz, s.rms_rad, len(s.knots_hz), s.density(a(.5, 1, 5, 12, 50))) for s in
    spectra], binned, [jitter.bins_of(spectra[0], h).variance.size for h in (.01, 7., 1e3)]
[jitter.fast_part(b, split, t) for b in binned for split, t in ((7., 1.), (0., .01), (1e9, 1.))]
made = [jitter.waves(b, 7., np.random.default_rng(3).normal(size=(999, 4))[: b.variance.size + 1],
    np.full(b.variance.size, .3)) for b in binned]
[w.at(a(0, .1, 1e3)) for w in made], [jitter.bend_variance(b, 7., h) for b in binned for h in (0.,
    .01, .2)]
modes = [flexible.oscillator(0, 3., .05, 2., None), flexible.oscillator(1, 30., .05, None, 4.),
    flexible.markov(1, 5., None, .5), flexible.markov(2, .01, 3., None), flexible.random_walk(2,
    .7), flexible.rate_markov(0, 9., .2), flexible.system(stiff, push, np.eye(3)),
    flexible.system(a(1)[None], a(1)[None], a(1, 2, 3)[:, None])]
[flexible.split(m, h, h / 4, 1.) for m in modes for h in (1e-3, .3)], [flexible.mean_variance(m,
    m.c, t) for m in modes for t in (.01, 10.)]
normal = np.random.default_rng(4).normal(size=(6, 5, 3))
[flexible.run(m, a(0, .5, .5, 2), normal[:2, :, : len(m.a)]) for m in modes]
[flexible.between(m, normal[0, :2, : len(m.a)], normal[1, :2, : len(m.a)], 2., 2, normal[2:4, :3, :
    len(m.a)]) for m in modes[:6]]
""",
    "meshes": """
n, s, o = a(0, 0, 1), np.array([[0, 0, 1], [.6, 0, .8], [.6, .64, .48], [1, 0, 0], [0, .6, -.8]]),
    a(-.48, .36, .8)
[brdf.lambert(n, s, v, .3) for v in (o, n, -n)], brdf.schlick(a(0, .5, 1), .04),
    [brdf.fresnel(a(.01, .5, 1), m) for m in (1.5, 1., 1.2 + 7j)]
[brdf.phong(n, s, v, .1, .4, e) for v in (o, s) for e in (1., 50.)]
[brdf.cook_torrance(n, s, o, .1, w, *more) for w in (.05, 1.) for more in ((), (1.5,), (1 + 6j,),
    (None, .9))]
[brdf.ashikhmin_shirley(n, s, o, .1, .5, 10., v, g) for v in (10., 100.) for g in ((1., 0, 0), (0,
    0, 1.), (1, 1., 5))]
angles, phi, grid = np.radians([0., 40, 90]), np.radians([0., 90, 180]), np.arange(27.).reshape(3,
    3, 3) / 100 + .02
t = brdf_table.brdf_table(angles, angles, phi, grid)
t.value, t(n, s, o), t.at(a(-1, 0, .5, 9), .3, a(0, 1, 2, 9)), t.reflected_share(a(0, 1, 1.5)),
    brdf_table.reciprocity_error(grid)
brdf_table.brdf_table(angles, angles[:1], phi[:1], grid[:, :1, :1]).at(1., .5, .2)
brdf_table.brdf_table(angles[1:], angles, phi, grid[1:])
brdf_table.brdf_table(angles, angles, phi * 1.01, grid)
brdf_table.brdf_table(angles, angles[::-1], phi, grid, "x")
brdf_table.brdf_table(angles, angles, phi, grid[:2])
brdf_table.brdf_table(angles, angles, phi, grid - .05)
brdf_table.brdf_table(angles, angles, phi, grid * np.nan)
brdf_table.brdf_table(angles, angles, phi, grid + .3)
corner = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij")).reshape(3, 8).T * a(.5, 1,
    1.5)
faces = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2,
    7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]])
box = facets.Facets(corner[faces], np.arange(12) % 2, np.ones(12, bool), True)
wing = facets.Facets(np.array([[[2, -1, 0], [4, -1, 0], [4, 1, .5]], [[2, -1, 0], [4, 1, .5], [2, 1,
    .5]]]), np.array([1, 1]), np.zeros(2, bool))
both = facets.together([but(box, convex=False), wing.moved(turn, (-.5, .2, 1.))])
box.cross_m2, box.area_m2, box.normal, box.radius_m, both, [facets.is_convex(c) for c in
    (box.corners_m, both.corners_m, np.zeros((20001, 3, 3)))]
[shells.closed_shells(f) for f in (faces, faces[:11], np.r_[faces, faces[:1] + 8, faces[:1] + 8],
    faces[:0])]
[shells.shell_volumes(c, np.zeros(12, int), 1) for c in (corner[faces], corner[faces[:, ::-1]] + 9)]
[bins.plane_axes(v) for v in (n, s[2], -n)], bins.binned(both.corners_m, bins.plane_axes(s[2]),
    both.area_m2 > 1)
grey = [intensity.FacetSurface(partial(brdf.lambert, albedo=.4)),
    intensity.FacetSurface(partial(brdf.phong,
    diffuse=.1, specular=.5, exponent=9.), True, 2)]
suns, looks = [s[0], s[1], s[2], s[4], unit(a(1, 2, -3)), unit(a(-1, 0, 2e-8))], [n, o, s[2],
    unit(a(3, -1, .5))]
[intensity.mesh_intensity(m, grey, x, v, error, .005) for m, error in ((box, 1e-3), (both, 1e-4))
    for x in suns for v in looks[1:]]
[intensity.seen_areas(m, v, e) for m in (box, both) for v in looks for e in (1e-2, 1e-5)],
    intensity.seen_areas(box.moved(0 * np.eye(3)), n)
intensity.mesh_intensity(both, grey, a(0, 0, 1.1), n)
intensity.mesh_intensity(both, grey, n, a(0, 1))
lit = intensity.mesh_intensity(both, grey, s[1], n, 1e-4)
[intensity.sun_points(s[2], .005, r) for r in (0, 1, 3)], [intensity.mesh_picture(both, lit, s[1],
    n, s[3], a(0, y, 0), cell) for y, cell in ((1, .3), (-1, .05), (1, 9.))]
intensity.mesh_picture(both, lit, s[1], n, a(1, 0, 0), a(1, 0, 0), .3)
intensity.mesh_picture(both, lit, s[1], n, a(1, 0, 0), a(0, 1, 0), 1e-4)
lamp = lambda k: (unit(np.stack([.3 * np.cos(np.arange(k * k)), .3 * np.sin(np.arange(k * k)),
    np.ones(k * k)], -1)), np.where(np.arange(k * k) % 5, 1., 0.) / (k * k))
[lamps.wide_lamp_intensity(m, grey, lamp, v, .01, b) for m in (box, both) for v in (o, -n) for b in
    (0., 9.)], lamps.wide_lamp_intensity(box, grey, lambda k: (-n[None], np.ones(1)), n)
joints = [None, model.Joint("fixed", n, a(1, 0, 0), s[3], .5), model.Joint("spin", s[2], a(0, 1, 0),
    s[3], .1, 2.), model.Joint("sun", s[3], a(0, 0, 1), n, .2)]
bodies = [model.MeshModel((model.RigidPart(but(box, convex=False)), model.RigidPart(wing, 0, turn,
    a(0, 0, 2), j), model.RigidPart(wing, 1, None, None, joints[3])), tuple(grey)) for j in joints]
[b.radius_m for b in bodies], model.MeshModel((), ()).radius_m, [model.posed(b, s[2], 3.3).corners_m
    for b in bodies]
model.tracking_angle(n, s[3], s), model.tracking_angle(n, n, o), model.tracking_angle(s[3], n, s[3])
time, way = np.linspace(0., 1., 7), a(0, 0, .1, .5, .9, 2, 2)
turned = unit(np.stack([np.cos(time), np.sin(time), .3 + 0 * time], -1))
[model.model_light(b, turned, np.repeat(o[None], 7, 0), time, .01, 0., step) for b in bodies[1:3]
    for step in (0., .5)], model.model_light(bodies[0], s[:0], s[:0], [])
[model.knots_of(way, step) for step in (0., .3, 9.)], [model.way_rad(b, (turned,), time) for b in
    bodies[1:3]]
glow = lambda phase, when: np.stack([2 + np.cos(when / 3), np.maximum(np.sin(phase + when / 9),
    0.)], -1)
made = [light_table.tabulated(glow, 0., 20., share, most, spins) for spins in (False, True) for
    share, most in ((.1, 10**5), (.02, 10**5), (.001, 99))]
made, made[3].at(a(-1, 0, 3, 20, 21), a(0, -1, 3, 6.28, 100)), light_table._off(a(1, 2)[:, None],
    a(1, 1)[:, None], 50.)
""",
}


@pytest.mark.parametrize("room", CASES)
def test_functions_at_edge_values(room: str) -> None:
    home = importlib.import_module(f"pipeline.physics.{room}")
    space: dict[str, Any] = {"it": home, "np": np, "unit": unit, "but": dataclasses.replace}
    space |= {"partial": functools.partial, "a": lambda *v: np.array(v, float)}
    space["turn"] = np.array([[0.8, 0, 0.6], [0, 1.0, 0], [-0.6, 0, 0.8]])
    for name in MODULES[room].split():
        space[name] = importlib.import_module(f"{home.__name__}.{name}")
    check_told(f"studies/physics-{room}", told_lines(CASES[room], space))
