"""Random sensors over the whole schema: optics of every kind, detectors, distortion, noise."""

from __future__ import annotations

from typing import Any

import numpy as np

from tests.extremes.stock import SIDE_PX, Stock

Data = dict[str, Any]


class Dice:
    """A generator of random numbers with the few questions that scenes ask of it."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)

    def pick(self, *options: Any) -> Any:
        return options[int(self.rng.integers(len(options)))]

    def chance(self, share: float) -> bool:
        return bool(self.rng.random() < share)

    def even(self, low: float, high: float) -> float:
        return float(self.rng.uniform(low, high))

    def spread(self, low: float, high: float) -> float:
        """Even in the logarithm."""
        return float(np.exp(self.rng.uniform(np.log(low), np.log(high))))

    def count(self, low: int, high: int) -> int:
        """A whole number, both ends included."""
        return int(self.rng.integers(low, high + 1))


def sensor(dice: Dice, stock: Stock, side_px: int) -> Data:
    """A telescope and its detector; frames of 1 to `side_px` pixels a side."""
    shape = [dice.count(1, side_px), dice.count(1, side_px)]
    with_images = dice.chance(0.1) and side_px >= SIDE_PX
    shape = [SIDE_PX, SIDE_PX] if with_images else shape
    pitch_um = dice.spread(2, 30)
    focal_m = dice.spread(0.02, 5)
    adc_bits = dice.pick(8, 12, 16, 16, 32, 63)
    bias_dn = min(dice.pick(0.0, 100.0, 1e17), 2.0 ** (adc_bits + 1))
    out: Data = {
        "shape": shape, "pixel_pitch_um": pitch_um, "focal_length_m": focal_m,
        "aperture_m": focal_m / dice.spread(1, 20), "obscuration": dice.pick(0.0, 0.0, 0.3, 0.6),
        "fill_factor": dice.pick(1.0, 1.0, 0.6), "bandpass": _band(dice),
        "transmission": dice.pick(1.0, 0.5), "quantum_efficiency": dice.pick(1.0, 0.8),
        "psf": psf(dice, stock, shape), "full_well_e": dice.pick(None, dice.spread(100, 1e7)),
        "gain_e_per_dn": dice.spread(1e-2, 1e2), "adc_bits": adc_bits,
        "adc_rounding": dice.pick("half_even", "floor"), "bias_dn": bias_dn,
        "flat": stock.image if with_images else dice.pick(1.0, 0.9),
        "dark_e_per_s": dice.pick(0.0, dice.spread(1e-6, 1e5)),
        "read_noise_e": dice.pick(0.0, 5.0, dice.spread(1e-2, 1e3)),
        "photon_noise": dice.chance(0.8),
    }  # fmt: skip
    if dice.chance(0.2):
        out["distortion"] = _distortion(dice)
    if dice.chance(0.3):
        out["detector"] = _detector(dice, shape, out["full_well_e"])
    return {k: v for k, v in out.items() if v is not None}


def _band(dice: Dice) -> Data:
    short = dice.even(350, 900)
    return dice.pick(
        {"kind": "box", "short_nm": 450, "long_nm": 750},
        {"kind": "box", "short_nm": short, "long_nm": short + dice.spread(1, 300)},
        {"kind": "named", "name": "bessell-V"},
    )


def psf(dice: Dice, stock: Stock, shape: list[int]) -> Data:
    """A point-spread function of any kind."""
    if dice.chance(0.12):
        return _field(dice, stock, shape)
    return one_psf(dice, stock, dice.pick("gaussian", "gaussian", "airy", "airy", "moffat",
                                          "kolmogorov", "table"))  # fmt: skip


def _field(dice: Dice, stock: Stock, shape: list[int]) -> Data:
    """The same kind at two to four places."""
    kind = dice.pick("gaussian", "airy", "moffat", "table")
    places = [[0.0, float(max(n - 1, 1))] if dice.chance(0.5) else [0.5 * n] for n in shape]
    common: Data = {"oversampling": dice.pick(16, 32)}
    if kind == "table":
        common["includes_pixel"] = dice.chance(0.2)
    psfs = [[one_psf(dice, stock, kind) | common for _ in places[1]] for _ in places[0]]
    if kind == "airy":
        vanes = psfs[0][0].get("vanes")
        psfs = [[{**p, "vanes": vanes} for p in row] for row in psfs]
    return {"kind": "field", "rows_px": places[0], "columns_px": places[1], "psfs": psfs}


def one_psf(dice: Dice, stock: Stock, kind: str) -> Data:
    out: Data = {"kind": kind, **_OPTICS[kind](dice, stock)}
    out["jitter_px"] = dice.pick(0.0, 0.0, 0.3)
    out["charge_diffusion_px"] = dice.pick(0.0, 0.0, 0.2)
    if dice.chance(0.2):
        out["oversampling"] = dice.pick(8, 16, 64, 128)
    return {k: v for k, v in out.items() if v is not None}


def _gaussian(dice: Dice, stock: Stock) -> Data:
    sigma = dice.spread(0.05, 8)
    narrow = dice.chance(0.25)
    return {
        "sigma_px": sigma, "angle_deg": dice.even(-90, 90) if narrow else None,
        "sigma_minor_px": max(0.05, 0.6 * sigma) if narrow else None,
    }  # fmt: skip


def _airy(dice: Dice, stock: Stock) -> Data:
    out: Data = {"wavelengths": dice.pick(None, 1, 2)}
    if dice.chance(0.25):
        terms = dice.pick([4], [7], [4, 11], [5, 8, 11, 22])
        rms = dice.spread(5, 500)
        out["aberrations"] = [{"noll": n, "rms_nm": rms / len(terms)} for n in terms]
    if dice.chance(0.1):
        out["defocus_um"] = dice.spread(1, 500)
    if dice.chance(0.15):
        out["vanes"] = {"count": dice.pick(3, 4), "width_m": dice.spread(1e-4, 1e-2)}
    return out


def _moffat(dice: Dice, stock: Stock) -> Data:
    return {"fwhm_px": dice.spread(0.3, 8), "beta": dice.pick(4.765, 2.5, 1.6, dice.even(1.5, 6))}


def _kolmogorov(dice: Dice, stock: Stock) -> Data:
    by_fwhm = dice.chance(0.5)
    return {
        "fwhm_arcsec": dice.spread(0.3, 5) if by_fwhm else None,
        "r0_m": None if by_fwhm else dice.spread(0.03, 0.5),
        "diffraction": dice.chance(0.7), "wavelengths": dice.pick(1, 2),
    }  # fmt: skip


def _table(dice: Dice, stock: Stock) -> Data:
    return {
        "path": stock.psf, "samples_per_px": dice.spread(1.5, 12), "centre": "middle",
        "light_fraction": dice.pick(1.0, 0.95), "includes_pixel": dice.chance(0.2),
    }  # fmt: skip


_OPTICS = {"gaussian": _gaussian, "airy": _airy, "moffat": _moffat, "kolmogorov": _kolmogorov,
           "table": _table}  # fmt: skip


def _distortion(dice: Dice) -> Data:
    size = dice.spread(1e-7, 1e-4)
    return dice.pick(
        {"kind": "sip", "a": {"2_0": size, "1_1": -size}, "b": {"0_2": 0.5 * size}},
        {"kind": "radial", "k1": dice.even(-0.2, 0.2), "p1": 1e-4},
        {"kind": "tpv", "pv1": {"4": 1e-3 * dice.even(-1, 1)}},
    )


def _detector(dice: Dice, shape: list[int], full_well_e: float | None) -> Data:
    """Each part with some chance; at least one."""
    ny, nx = shape
    parts: Data = {
        "bad": {"fraction": 0.01, "reads_dn": dice.pick(0, 255)},
        "dead": {"pixels": [[0, 0]], "rows": [ny - 1]},
        "hot": {"fraction": 0.02, "median_e_per_s": dice.spread(1, 1e4)},
        "prnu": 0.02, "row_noise_e": dice.spread(0.1, 100), "column_noise_e": 1.0,
        "bias_structure": {"row_rms_dn": 2.0, "pixel_rms_dn": 1.0, "column_slope_dn": 10.0},
        "amplifiers": [{"rows": [0, ny], "columns": [0, max(1, nx // 2)], "gain_e_per_dn": 2.0,
                        "read_noise_e": 3.0}],
        "readout": dice.pick(
            {"kind": "frame_transfer", "transfer_s": dice.spread(1e-4, 1)},
            {"kind": "tdi", "rows_per_s": dice.even(-50, 50)},
            {"kind": "rolling", "line_s": dice.spread(1e-6, 1e-2)},
        ),
    }  # fmt: skip
    if full_well_e is not None:
        parts |= {
            "nonlinearity": {"kind": "polynomial", "coefficients": [-0.02]},
            "lag": {"fraction": dice.pick(0.002, 0.05)}, "blooming": True,
        }  # fmt: skip
    kept = {k: v for k, v in parts.items() if dice.chance(0.3)} or {"prnu": 0.02}
    if kept.get("readout", {}).get("kind") == "tdi":
        kept = {k: v for k, v in kept.items() if k not in ("lag", "blooming")}
    return kept
