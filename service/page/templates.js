// Scenes to start from; `catalogue` is a registered one, or absent where there is none.

const telescope = {
  shape: [2048, 2048], pixel_pitch_um: 9, focal_length_m: 1, aperture_m: 0.4, obscuration: 0.35,
  bandpass: { kind: "box", short_nm: 400, long_nm: 900 }, transmission: 0.8, quantum_efficiency: 0.85,
  psf: { kind: "airy", jitter_px: 0.6 }, full_well_e: 90000, gain_e_per_dn: 1.5, bias_dn: 500,
  dark_e_per_s: 0.5, read_noise_e: 6,
};
const site = { kind: "ground", latitude_deg: 20.7, longitude_deg: -156.3, height_m: 3055 };
const start = { schema: "nightglass/scene/1", epoch: "2019-07-20T09:00:00Z", seed: 7 };

const geo = (name, position_m, velocity_m_s, diameter_m) => ({
  name, orbit: { kind: "state", position_m, velocity_m_s },
  body: { kind: "sphere", diameter_m, albedo: 0.2 },
});

const stars = (catalogue) => (catalogue ? { stars: { catalogue, faintest_g_mag: 16.5 } } : {});

export const TEMPLATES = {
  "rate track of a geostationary satellite": (catalogue) => ({
    ...start, name: "geo-rate-track", observer: site, sensor: telescope,
    pointing: { mode: "target", target: "geo-1" },
    exposure: { integration_s: 3, frames: 3, cadence_s: 10 }, ...stars(catalogue),
    targets: [
      geo("geo-1", [4407338.1, -41933005.2, -36593.5], [3057.8229, 321.39, 0.2805], 4),
      geo("geo-2", [4663629.8, -41907301.3, -14628.4], [3055.7302, 340.0551, 0.1187], 2),
      geo("geo-3", [4270157.1, -41957767.6, 140299.8], [3058.476, 311.27, 60], 3),
    ],
    background: { uniform_mag_arcsec2: 20.8 },
  }),
  "sidereal stare at a field": (catalogue) => ({
    ...start, name: "sidereal-stare", observer: site,
    sensor: { ...telescope, psf: { kind: "gaussian", sigma_px: 0.9 } },
    pointing: { mode: "sidereal", boresight_ra_deg: 276, boresight_dec_deg: -3.2, roll_deg: 15 },
    exposure: { integration_s: 5 }, ...stars(catalogue),
    background: { uniform_mag_arcsec2: 20.8 },
  }),
};
