"""Random scenes: never a traceback, never a NaN, light always conserved; broken ones are named."""

from __future__ import annotations

import importlib.util
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import zarr
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from catalog_tools.ingest import ingest
from pipeline.errors import BadInput
from pipeline.prepare import plan_scene
from pipeline.run import Options, render
from pipeline.spec.load import parse_scene

_spec = importlib.util.spec_from_file_location("fuzz_scenes", Path(__file__).with_name("scenes.py"))
assert _spec is not None
assert _spec.loader is not None
random_scenes = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(random_scenes)

FEW, MANY = 50, 1000
CALM = [HealthCheck.too_slow, HealthCheck.data_too_large]


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory) -> str:
    """3,000 stars all over the sky, two of them on the poles."""
    folder = tmp_path_factory.mktemp("fuzz")
    rng = np.random.default_rng(1)
    ra, dec = rng.uniform(0, 360, 3000), np.degrees(np.arcsin(rng.uniform(-1, 1, 3000)))
    dec[:2] = 90.0, -90.0
    rows = [f"{i + 1},{r},{d},{g}" for i, (r, d, g) in
            enumerate(zip(ra, dec, rng.uniform(2, 14, 3000), strict=True))]  # fmt: skip
    csv = folder / "stars.csv"
    csv.write_text("\n".join(["source_id,ra,dec,phot_g_mean_mag", *rows]) + "\n")
    ingest([csv], folder / "catalogue", form="gaia_dr2", workers=1)
    return str(folder / "catalogue")


def told(refusal: BadInput) -> None:
    """A refusal names its field, is short, and can be printed."""
    assert refusal.field
    assert len(str(refusal).encode()) < 1000


def whole(data: dict[str, Any]) -> None:
    """A scene renders to a frame whose parts add up, or is refused by a message with its field."""
    with tempfile.TemporaryDirectory() as folder:
        product = Path(folder) / "p"
        try:
            render(parse_scene(data), product, Options("synchronous"))
        except BadInput as refusal:
            told(refusal)
            return
        group = zarr.open_group(product / "cube.zarr", mode="r")
        layers = {name: np.asarray(group[name]).astype(float) for name in data["output"]["layers"]}
        mean = layers["mean_e"]
        parts = sum(v for k, v in layers.items() if k not in ("dn", "mean_e"))
        assert all(np.isfinite(v).all() for v in layers.values())
        assert mean.min() >= 0.0
        assert layers["dn"].max() <= 2.0 ** data["sensor"]["adc_bits"]
        scale = 1e-6 * float(np.abs(parts).max()) + 1e-30
        assert np.abs(parts - mean).max() <= 2.0 * scale + 0.1 * _sigma(data)
        for kind in ("stars", "targets"):
            if f"{kind}_e" in layers:
                truth = pq.read_table(product / "truth" / f"{kind}.parquet")
                sent = truth["electrons"].to_numpy()
                assert (sent >= 0).all()
                drawn, flat = layers[f"{kind}_e"].sum(), data["sensor"]["flat"]
                # light of stars off the frame may fall on it, that of targets is all in the truth
                if kind == "targets":
                    assert drawn <= sent.sum() * flat * (1 + 1e-3) + _sigma(data) * mean.size


def _sigma(data: dict[str, Any]) -> float:
    """A noise that is surely above that of an empty pixel's read-out and rounding [e-]."""
    s = data["sensor"]
    return float(np.hypot(s["read_noise_e"], s["gain_e_per_dn"]) + 1e-6)


def refused_or_planned(data: dict[str, Any]) -> None:
    """A broken scene is refused by name of the field, or is no broken one and can be planned."""
    try:
        plan_scene(parse_scene(data))
    except BadInput as refusal:
        told(refusal)


def _fuzz(check, strategy, count: int) -> None:
    run = settings(max_examples=count, deadline=None, suppress_health_check=CALM)(
        given(st.deferred(lambda: strategy))(check)
    )
    run()


def test_random_scenes(catalogue):
    _fuzz(whole, random_scenes.scenes(catalogue, random_scenes.SMALL_PX), FEW)


def test_broken_scenes(catalogue):
    _fuzz(refused_or_planned, random_scenes.broken(catalogue, random_scenes.SMALL_PX), FEW)


@pytest.mark.slow
def test_many_random_scenes(catalogue):
    _fuzz(whole, random_scenes.scenes(catalogue), MANY)


@pytest.mark.slow
def test_many_broken_scenes(catalogue):
    _fuzz(refused_or_planned, random_scenes.broken(catalogue), MANY)
