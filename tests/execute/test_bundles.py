"""Bundles: the same work in fewer tasks, each step once, nothing kept longer than it is needed."""

from __future__ import annotations

from functools import partial

import pytest
from hypothesis import given
from hypothesis import strategies as st

from catalog_tools.engine.schedulers import LocalScheduler
from pipeline.execute.bundles import MOST_TILES, bundled, tiles_a_bundle, tiles_done
from pipeline.route.run import Options, render
from pipeline.spec.load import parse_scene


def noted(log, *parts):
    """A task that leaves a note and sums what it gets."""
    log.append(parts)
    return sum(sum(p) if isinstance(p, list) else p for p in parts)


def small_graph(frames, tiles, log):
    """Frames of tiles that share a place task in their frame, and one with the frame before."""
    graph, wanted, note = {}, [], partial(noted, log)  # a list among arguments is one of keys
    for f in range(frames):
        graph["place", f] = (note, 1)
        before = [("place", f - 1)] if f else []
        for t in range(tiles):
            graph["tile", f, 0, t] = (note, [("place", f), *before], t)
            wanted.append(("tile", f, 0, t))
    for f in range(frames):
        graph["truth", f] = (note, [("place", f)])
        wanted.append(("truth", f))
    return graph, wanted


@given(st.integers(1, 5), st.integers(1, 7), st.integers(1, 20))
def test_same_work_in_fewer_tasks(frames, tiles, size):
    plain, together = [], []
    run = LocalScheduler("synchronous", 1).run
    graph, wanted = small_graph(frames, tiles, plain)
    run(graph, wanted, lambda _: None)
    done = []
    run(*bundled(*small_graph(frames, tiles, together), size), done.append)
    assert sorted(map(repr, plain)) == sorted(map(repr, together))
    assert len(plain) == frames * (tiles + 2)
    counts = [tiles_done(kind) for kind in done if tiles_done(kind)]
    assert sum(counts) == frames * tiles
    assert max(counts) <= size


def test_how_many_tiles_a_task_draws():
    assert tiles_a_bundle(0.07, 1.0, 10_000, 2) == 15
    assert tiles_a_bundle(2.0, 1.0, 10_000, 2) == 1
    assert tiles_a_bundle(0.0, 1.0, 1_000_000, 2) == MOST_TILES
    assert tiles_a_bundle(0.07, 1.0, 64, 8) == 2  # four tasks a worker


def test_streams_of_graphs_on_a_cluster():
    """Graphs are taken as there is room; an error ends the stream."""
    from distributed import Client, LocalCluster

    from catalog_tools.engine.cluster_scheduler import FEWEST_WAITING, ClusterScheduler
    from catalog_tools.errors import BadInput

    taken, done = [], []

    def graphs():
        for i in range(40):
            taken.append(len(done))
            keys = [("tile", i, k) for k in range(8)]
            yield dict.fromkeys(keys, (int, "1")), keys

    with LocalCluster(
        n_workers=1, threads_per_worker=2, processes=False, dashboard_address=":0"
    ) as cluster, Client(cluster, set_as_default=False) as client:  # fmt: skip
        ClusterScheduler(client, 2).stream(graphs(), done.append)
        assert done == ["tile"] * 320
        assert all(8 * i - before < FEWEST_WAITING for i, before in enumerate(taken))
        bad = {("tile", 0): (int, "x"), ("tile", 1): (bad_input, 1)}
        with pytest.raises((BadInput, ValueError)):
            ClusterScheduler(client, 2).stream([(bad, list(bad))], done.append)


def bad_input(_):
    from catalog_tools.errors import BadInput

    raise BadInput("x", 1, "y")


def test_same_bits_in_bundles(tmp_path, monkeypatch):
    """Targets, lag and truth: many tiles a task, or one."""
    scene = parse_scene({
        "schema": "nightglass/scene/1", "name": "b", "epoch": "2019-07-20T09:00:00Z",
        "accept": ["moon"],
        "observer": {"kind": "fixed", "position_au": [1, 0, 0]},
        "sensor": {
            "shape": [512, 512], "pixel_pitch_um": 9.0, "focal_length_m": 0.5, "aperture_m": 0.1,
            "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900}, "read_noise_e": 4.0,
            "psf": {"kind": "gaussian", "sigma_px": 0.8},
        },
        "pointing": {"mode": "target", "target": "sat"},
        "targets": [{
            "name": "sat", "body": {"kind": "sphere", "diameter_m": 1e6, "albedo": 0.5},
            "orbit": {"kind": "state", "position_m": [4.2e7, 0, 0], "velocity_m_s": [0, 3070, 0]},
        }],
        "exposure": {"integration_s": 1.0, "frames": 3}, "output": {"tile_shape": [256, 256]},
    })  # fmt: skip
    digests = []
    for size in (1, 5, 8):
        monkeypatch.setattr("pipeline.route.draw.tiles_a_bundle", lambda *_, size=size: size)
        told = []
        report = render(scene, tmp_path / str(size), Options("synchronous"), told.append)
        digests.append((report["content_digest"], report["truth_rows"]))
        assert (told[0].done, told[-1].done) == (0, 12)
    assert len({str(d) for d in digests}) == 1
