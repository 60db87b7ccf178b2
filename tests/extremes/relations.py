"""Random scenes whose frames must agree: `python -m tests.extremes.relations 0:100`.

A scene is drawn, and then others in which one thing is different whose effect on the light is known
without any formula of the product: it is turned by 180 degrees, exposed in two halves, begun later.
"""

from __future__ import annotations

import argparse
import copy
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from astropy.time import Time, TimeDelta
from numpy.typing import NDArray

from pipeline.errors import NightglassError
from pipeline.route.run import Options, render
from pipeline.spec.load import parse_scene
from pipeline.store.cube import open_cube
from tests.extremes.random_sensors import Data, Dice
from tests.extremes.scenes import FAR_EPOCHS, random_scene
from tests.extremes.stock import Stock, make_stock

Image = NDArray[np.float64]

PARTS = {"stars": "stars_e", "targets": "targets_e", "background": "background_e"}
SIDE_PX, LONGEST_S, MARGIN_PX, BRIGHT = 48, 30.0, (7, 12), 50.0
ASKED = {"noise_fraction": 0.02, "flux_fraction": 1e-3, "check_cells": 0}
MOST_CPU_S, MOST_MB = 20.0, 2500.0
SYMMETRIC = ("gaussian", "airy", "moffat", "kolmogorov")
LOPSIDED = {"aberrations", "vanes", "defocus_um", "sigma_minor_px"}
LENGTHS_PX = ("sigma_px", "sigma_minor_px", "fwhm_px", "jitter_px", "charge_diffusion_px")
SIZES_M = ("diameter_m", "edge_m", "length_m", "base_diameter_m", "top_diameter_m")


@dataclass(frozen=True)
class Drawn:
    """Frames of a scene: light by part and together, and what each pixel may err by [e-]."""

    parts: dict[str, Image]
    light_e: Image
    allowed_e: Image
    noise_e: Image


def draw(data: Data) -> Drawn:
    """Render a scene; NightglassError where it is refused."""
    with tempfile.TemporaryDirectory() as folder:
        options = Options("synchronous", most_cpu_s=MOST_CPU_S, most_memory_mb=MOST_MB)
        report = render(parse_scene(data), Path(folder) / "run", options)
        with open_cube(Path(folder) / "run") as cube:
            layers = {k: np.asarray(cube[k], float) for k in data["output"]["layers"]}
    light = sum((v for k, v in layers.items() if k in PARTS.values()), 0.0 * layers["mean_e"])
    sensor = data["sensor"]
    noise = np.sqrt(light + layers["dark_e"] + sensor["read_noise_e"] ** 2)
    allowed = ASKED["noise_fraction"] * noise + report["errors"]["bound_of_all_approximations_e"]
    return Drawn(layers, np.asarray(light), allowed + 1e-9 * np.abs(light).max(), noise)


def scene(seed: int, stock: Stock) -> Data:
    """A random scene without detector effects and rays, in most cases looking at its targets."""
    data, dice = random_scene(seed, stock, SIDE_PX), Dice(seed)
    for key in ("cosmic_rays", "dwells"):
        data.pop(key, None)
    sensor, pointing = data["sensor"], data["pointing"]
    sensor.pop("detector", None)
    sensor |= {"flat": 1.0, "photon_noise": True, "read_noise_e": dice.spread(0.5, 10.0)}
    if data.get("targets") and pointing["mode"] in ("sidereal", "rate") and dice.chance(0.8):
        data["pointing"] = {"mode": "target", "target": "t0", "roll_deg": dice.even(-180, 180)}
    time_s = min(data["exposure"]["integration_s"], LONGEST_S)
    present = [layer for part, layer in PARTS.items() if data.get(part)]
    return data | {
        "accept": ["sun", "moon", "daylight", "coverage", "error"], "accuracy": dict(ASKED),
        "exposure": {"integration_s": time_s, "frames": 1},
        "output": {"layers": ["mean_e", "dark_e", *present]},
    }  # fmt: skip


def brightened(data: Data, drawn: Drawn) -> Data:
    """Targets so large that they show, where they are in the frame at all."""
    peak = float((drawn.parts.get("targets_e", np.zeros(1)) / drawn.noise_e).max())
    if not 0.0 < peak < BRIGHT:
        return data
    factor, out = min(1e5, (BRIGHT / peak) ** 0.5), copy.deepcopy(data)
    for target in out["targets"]:
        for shape in (target["body"], *target["body"].get("parts", [])):
            shape |= {k: min(factor * shape[k], 2e4) for k in SIZES_M if k in shape}
            if "size_m" in shape:
                shape["size_m"] = [min(factor * v, 2e4) for v in shape["size_m"]]
            if "area_m2" in shape:
                shape["area_m2"] = min(factor**2 * shape["area_m2"], 1e8)
    return out


# Each relation yields (the light that the scene has, what another has that must be the same, and
# what both may err by), or nothing where it does not hold for a scene.
Pairs = Iterator[tuple[Image, Image, Image]]


def halves(data: Data, one: Drawn) -> Pairs:
    """Two exposures of half the time, one after the other, gather as much.

    Jitter is a function of time; modes are drawn from frame to frame, so that two are another run.
    """
    if (data["pointing"].get("attitude") or {}).get("modes"):
        return
    half_s = 0.5 * data["exposure"]["integration_s"]
    exposure = {"integration_s": half_s, "frames": 2, "cadence_s": half_s}
    two = draw(data | {"exposure": exposure})
    yield one.light_e[0], two.light_e.sum(axis=0), one.allowed_e[0] + two.allowed_e.sum(axis=0)


def dimmer(data: Data, one: Drawn) -> Pairs:
    """Optics that let half of it through halve the light of stars and targets."""
    sensor = data["sensor"] | {"transmission": 0.5 * data["sensor"]["transmission"]}
    two = draw(data | {"sensor": sensor})
    for layer in ("stars_e", "targets_e"):
        if layer in one.parts:
            yield one.parts[layer], 2.0 * two.parts[layer], one.allowed_e + 2.0 * two.allowed_e


def larger(data: Data, one: Drawn) -> Pairs:
    """A larger frame shows the same in its middle."""
    if data["sensor"]["psf"]["kind"] == "field":
        return
    (rows, columns), (y, x) = data["sensor"]["shape"], MARGIN_PX
    two = draw(data | {"sensor": data["sensor"] | {"shape": [rows + 2 * y, columns + 2 * x]}})
    middle = np.s_[0, y:-y, x:-x]
    yield one.light_e[0], two.light_e[middle], one.allowed_e[0] + two.allowed_e[middle]


def turned(data: Data, one: Drawn) -> Pairs:
    """A camera that is turned by 180 degrees shows the frame upside down."""
    psf, pointing = data["sensor"]["psf"], data["pointing"]
    uneven = psf["kind"] not in SYMMETRIC or LOPSIDED & set(psf) or data["sensor"].get("distortion")
    if uneven or pointing.get("attitude") or "roll_deg" not in pointing:
        return
    roll_deg = pointing["roll_deg"]
    roll_deg += -180.0 if roll_deg > 0.0 else 180.0
    two = draw(data | {"pointing": pointing | {"roll_deg": roll_deg}})
    about = np.s_[0, ::-1, ::-1]
    yield one.light_e[0], two.light_e[about], one.allowed_e[0] + two.allowed_e[about]


def finer(data: Data, one: Drawn) -> Pairs:
    """Pixels of half the size gather in four what one does."""
    sensor, background = copy.deepcopy(data["sensor"]), dict(data.get("background", {}))
    psf, (rows, columns) = sensor["psf"], sensor["shape"]
    sampled = psf["kind"] == "field" or psf.get("includes_pixel")
    if sampled or sensor.get("distortion") or sensor["fill_factor"] < 1.0:
        return
    psf |= {k: 2.0 * psf[k] for k in LENGTHS_PX if k in psf}
    if "samples_per_px" in psf:
        psf["samples_per_px"] *= 0.5
    psf.pop("oversampling", None)
    sensor |= {
        "pixel_pitch_um": 0.5 * sensor["pixel_pitch_um"], "shape": [2 * rows, 2 * columns],
    }  # fmt: skip
    if "uniform_e_per_s" in background:
        background["uniform_e_per_s"] *= 0.25
    two = draw(data | {"sensor": sensor} | ({"background": background} if background else {}))
    light, allowed = (
        v[0].reshape(rows, 2, columns, 2).sum(axis=(1, 3)) for v in (two.light_e, two.allowed_e)
    )
    yield one.light_e[0], light, one.allowed_e[0] + allowed


def twice(data: Data, one: Drawn) -> Pairs:
    """Targets that are there twice, in another order, send twice the light."""
    if not data.get("targets"):
        return
    again = [t | {"name": f"{t['name']}-again"} for t in reversed(data["targets"])]
    two = draw(data | {"targets": [*again, *data["targets"]]})
    layer = "targets_e"
    yield 2.0 * one.parts[layer], two.parts[layer], 2.0 * one.allowed_e + two.allowed_e


def alone(data: Data, one: Drawn) -> Pairs:
    """Stars, and targets, are drawn as they are without the others and the sky."""
    for part, layer in (("stars", "stars_e"), ("targets", "targets_e")):
        if layer not in one.parts:
            continue
        others = {"stars", "targets", "populations", "background"} - {part}
        other = {k: v for k, v in data.items() if k not in others}
        if part == "targets" and data.get("populations"):
            other["populations"] = data["populations"]
        if part == "stars" and data["pointing"]["mode"] == "target":
            dark = {"kind": "sphere", "diameter_m": 1e-6, "albedo": 0.0}
            other["targets"] = [data["targets"][0] | {"body": dark}]
        two = draw(other | {"output": {"layers": ["mean_e", "dark_e", layer]}})
        yield one.parts[layer], two.parts[layer], one.allowed_e + two.allowed_e


def later(data: Data, one: Drawn) -> Pairs:
    """The third frame of three is that of a scene which begins then."""
    pointing, epoch = data["pointing"], data["epoch"]
    if pointing.get("attitude") or pointing["mode"] == "rate" or epoch in FAR_EPOCHS:
        return
    dated, time_s = _dated(data), data["exposure"]["integration_s"]
    cadence_s = time_s + 0.5
    exposure = {"integration_s": time_s, "frames": 3, "cadence_s": cadence_s}
    three = draw(dated | {"exposure": exposure})
    yield one.light_e[0], three.light_e[0], one.allowed_e[0] + three.allowed_e[0]
    begins = Time(epoch.rstrip("Z"), precision=9) + TimeDelta(2.0 * cadence_s, format="sec")
    last = draw(dated | {"epoch": f"{begins.isot}Z"})
    yield three.light_e[2], last.light_e[0], three.allowed_e[2] + last.allowed_e[0]


def _dated(data: Data) -> Data:
    """A scene in which all that counts from the scene's epoch names it."""
    out, epoch = copy.deepcopy(data), data["epoch"]
    orbits = [t["orbit"] for t in out.get("targets", [])]
    for orbit in [*orbits, *([out["observer"]["orbit"]] if "orbit" in out["observer"] else [])]:
        if orbit["kind"] not in ("tle", "omm"):
            orbit.setdefault("epoch", epoch)
    for body in [t["body"] for t in out.get("targets", [])]:
        for turning in (body, *body.get("parts", [])):
            if turning.get("attitude", {}).get("kind") in ("spin", "table"):
                turning["attitude"].setdefault("epoch", epoch)
        if body["kind"] == "light_curve":
            body.setdefault("epoch", epoch)
    if out["pointing"]["mode"] == "table":
        out["pointing"].setdefault("epoch", epoch)
    return out


RELATIONS: tuple[Callable[[Data, Drawn], Pairs], ...] = (
    halves, dimmer, larger, turned, finer, twice, alone, later,
)  # fmt: skip


def broken(seed: int, stock: Stock) -> tuple[list[str], list[str]]:
    """Which relations were looked at for a seed's scene, and what of them does not hold."""
    data = scene(seed, stock)
    try:
        data = brightened(data, draw(data))
        one = draw(data)
    except NightglassError:
        return [], []
    held, wrong = [], []
    for relation in RELATIONS:
        try:
            for own, other, allowed in relation(data, one):
                held.append(relation.__name__)
                off = np.abs(own - other) / allowed
                if not off.max() <= 1.0:
                    at = np.unravel_index(int(np.argmax(off)), off.shape)
                    told = f"{own[at]:.6g} and {other[at]:.6g} e-, {off[at]:.3g} of what is allowed"
                    wrong.append(f"seed {seed}, {relation.__name__}: {told}")
        except NightglassError:
            continue  # the other scene is one that is refused
    return held, wrong


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", help="FIRST:END")
    first, end = (int(v) for v in parser.parse_args().seeds.split(":"))
    with tempfile.TemporaryDirectory() as folder:
        stock = make_stock(Path(folder))
        for seed in range(first, end):
            held, wrong = broken(seed, stock)
            print(f"seed {seed}: {len(held)} relations", *wrong, sep="\n    ", flush=True)


if __name__ == "__main__":
    main()
