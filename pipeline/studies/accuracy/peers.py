"""Other simulators on the same stars: found at run time, each optional, each told what it cannot.

GalSim and photutils run in this process, SatSim by the Python that has it, SkyMaker as the program
`sky`. None of them is needed, and none is imported unless it is asked for.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
from collections.abc import Callable
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.studies.accuracy.engines import Drawn, EngineCase, Setting
from pipeline.studies.accuracy.external import External, run_satsim, run_skymaker
from pipeline.studies.accuracy.reference import AiryStar, GaussianStar, exact_pixels

Array = NDArray[np.float64]

SATSIM_PYTHON = "NIGHTGLASS_SATSIM_PYTHON"
OVERSAMPLING = (3, 5, 9)  # of SatSim and SkyMaker
TABLE_HALF_PX = 24  # of tabulated responses for photutils


class Peer(NamedTuple):
    """A peer: its version or None where it is not installed, and what it cannot draw."""

    name: str
    version: str | None
    cannot: str


def installed_peers(satsim_python: str | None = None) -> list[Peer]:
    """Every peer that has an adapter, with the version found."""
    satsim = satsim_python or os.environ.get(SATSIM_PYTHON)
    return [
        Peer("GalSim", _version("galsim"), "curved streaks"),
        Peer("photutils", _version("photutils"), "streaks; diffraction only from a table"),
        Peer(
            "SatSim",
            satsim and shutil.which(satsim) and f"by {SATSIM_PYTHON}",
            "an obscured aperture by Q (it takes one from POPPY; it was given ours, sampled); "
            "curved streaks of stars",
        ),
        Peer(
            "SkyMaker",
            shutil.which("sky") and "the program sky",
            "a Gaussian and long streaks by itself (it was given tables)",
        ),
    ]


def _version(module: str) -> str | None:
    if importlib.util.find_spec(module) is None:
        return None
    try:
        return version(module)
    except PackageNotFoundError:
        return "unknown"


def peer_settings(case: EngineCase, quick: bool) -> list[Setting]:
    """Ladders of the peers that run in this process, for a case that they can draw."""
    if case.curved:
        return []
    out: list[Setting] = []
    if _version("galsim"):
        out += [Setting("GalSim", s, partial(_galsim, accuracy=a), ours=False) for s, a in GALSIM]
    if _version("photutils") and not case.streak_px:
        out += _photutils_settings(case)
    return out[:: max(1, len(out) // 2)] if quick else out


GALSIM: tuple[tuple[str, dict[str, float]], ...] = (
    ("default", {}),
    ("maxk 1e-4, kvalue 1e-6", {"maxk_threshold": 1e-4, "kvalue_accuracy": 1e-6}),
    (
        "… folding 5e-4",
        {
            "maxk_threshold": 1e-4,
            "kvalue_accuracy": 1e-6,
            "folding_threshold": 5e-4,
        },
    ),
)


def _galsim(case: EngineCase, accuracy: dict[str, float]) -> Drawn:
    """GalSim: a profile convolved with the pixel, drawn star by star on stamps of its own size."""
    import galsim

    params = galsim.GSParams(**accuracy)
    if isinstance(case.shape, GaussianStar):
        star = galsim.Gaussian(sigma=case.shape.sigma_px, gsparams=params)
    else:
        star = galsim.Airy(
            lam_over_diam=case.shape.q_px, obscuration=case.shape.obscuration, gsparams=params
        )
    if case.streak_px:
        dx, dy = np.diff(case.track.x_px[0])[0], np.diff(case.track.y_px[0])[0]
        box = galsim.Box(case.streak_px, 1e-3, gsparams=params)
        star = galsim.Convolve(star, box.rotate(np.arctan2(dy, dx) * galsim.radians))

    def draw(x: Array, y: Array, light: Array) -> Array:
        image = galsim.ImageD(case.frame[1], case.frame[0], xmin=0, ymin=0)
        for a, b, e in zip(x, y, light, strict=True):
            stamp = (star * e).drawImage(scale=1.0, center=galsim.PositionD(a, b), dtype=float)
            common = stamp.bounds & image.bounds
            if common.isDefined():
                image[common] += stamp[common]
        return image.array

    return Drawn(draw)


def _photutils_settings(case: EngineCase) -> list[Setting]:
    if isinstance(case.shape, GaussianStar):
        return [
            Setting("photutils", f"{n} px stamps", partial(_photutils, side=n), ours=False)
            for n in (5, 7, 9, 13)
        ]
    side = 2 * TABLE_HALF_PX - 3
    return [
        Setting("photutils", f"table {n} x", partial(_photutils, side=side, table=n), ours=False)
        for n in (2, 4, 8)
    ]


def _photutils(case: EngineCase, side: int, table: int = 0) -> Drawn:
    """photutils: a pixel-integrated Gaussian, or a spline between the samples of a table."""
    from astropy.table import Table
    from photutils.datasets import make_model_image
    from photutils.psf import CircularGaussianSigmaPRF, ImagePSF

    model: object
    if isinstance(case.shape, GaussianStar):
        model = CircularGaussianSigmaPRF(sigma=case.shape.sigma_px)
    else:
        model = ImagePSF(oversampled(case, table, TABLE_HALF_PX), oversampling=table)

    def draw(x: Array, y: Array, light: Array) -> Array:
        stars = Table({"x_0": x, "y_0": y, "flux": light})
        return make_model_image(case.frame, model, stars, model_shape=(side, side))

    return Drawn(draw)


def oversampled(case: EngineCase, per_px: int, half_px: int) -> Array:
    """Exact light of pixels whose centres stand 1/`per_px` apart, out to `half_px`."""
    at = np.arange(-half_px * per_px, half_px * per_px + 1) / per_px
    return exact_pixels(case.shape, case.track, 0.0, 0.0, at, at)


def external_settings(
    case: EngineCase, quick: bool, satsim_python: str | None = None
) -> list[tuple[str, str, Callable[..., External]]]:
    """(engine, setting, run) of peers that draw all probes in one go, in a process of their own."""
    python = satsim_python or os.environ.get(SATSIM_PYTHON, "")
    if case.curved or case.streak_px > 100:
        return []
    most = 1 if quick else len(OVERSAMPLING)
    peers: list[tuple[str, int, Callable[..., External]]] = []
    if shutil.which(python):
        finest = 3 - (case.streak_px > 0 or isinstance(case.shape, AiryStar))
        satsim = partial(run_satsim, python=python)
        peers.append(("SatSim, FFT", min(most, 2), partial(satsim, table=False)))
        peers.append(("SatSim, table", min(most, finest), partial(satsim, table=True)))
    if shutil.which("sky"):
        peers.append(("SkyMaker", most, run_skymaker))
    return [
        (name, f"oversampling {factor}", partial(run, oversampling=factor))
        for name, levels, run in peers
        for factor in OVERSAMPLING[:levels]
    ]
