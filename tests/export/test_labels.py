"""Labels of a frame: which sources it holds, and which way their streaks run."""

from __future__ import annotations

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pipeline.export.formats import ExportRequest, export_product
from pipeline.export.labels import frame_labels
from pipeline.export.masks import source_masks
from pipeline.export.response import SourceLight, path_between
from pipeline.export.satnet import annotation
from pipeline.export.times import ExposureTimes
from pipeline.physics.psf.pupil import Blur, Gaussian
from pipeline.store.cube import read_layer

SHAPE = 100, 300  # rows, columns


def labels_of(folder, paths):
    """Labels of targets with given straight paths ((x, y) of start and end) [px]."""
    start, end = np.array(paths, float).transpose(1, 2, 0)
    middle = 0.5 * (start + end)
    n = len(paths)
    table = {
        "frame": np.zeros(n, np.int32), "name": [f"t{i}" for i in range(n)],
        "x_px": middle[0], "y_px": middle[1], "x_start_px": start[0], "y_start_px": start[1],
        "x_end_px": end[0], "y_end_px": end[1], "ra_deg": np.zeros(n), "dec_deg": np.zeros(n),
        "electrons": np.arange(n, 0.0, -1.0), "snr": np.full(n, 9.0), "radius_px": np.zeros(n),
    }  # fmt: skip
    (folder / "truth").mkdir()
    pq.write_table(pa.table(table), folder / "truth" / "targets.parquet")
    return frame_labels(folder, 0, SHAPE)


def test_a_frame_wider_than_high_keeps_what_crosses_it(tmp_path):
    """Columns bound x and rows bound y, to half a pixel beyond the outermost centres."""
    within = [
        ((250, 50), (250, 50)), ((299.4, 99.4), (299.4, 99.4)), ((-0.4, -0.4), (-0.4, -0.4)),
        ((250, -40), (250, 140)), ((-50, 50), (400, 50)), ((270, -20), (330, 40)),
    ]  # fmt: skip
    beyond = [
        ((50, 150), (50, 150)), ((299.6, 50), (299.6, 50)), ((50, 99.6), (50, 99.6)),
        ((50, 120), (90, 280)), ((301, -20), (330, 20)), ((320, -40), (320, 140)),
    ]  # fmt: skip
    kept = labels_of(tmp_path, [*within, *beyond])
    assert kept.name.tolist() == [f"t{i}" for i in range(len(within))]


def test_targets_behind_the_camera_for_a_part_are_labelled(tmp_path):
    """By where they are seen: in the middle of the exposure, or at the other end; between both ends
    where the middle alone is lost."""
    labels_of(tmp_path, [((50, 50), (90, 50))] * 5)
    table = pq.read_table(tmp_path / "truth" / "targets.parquet").to_pydict()
    lost_of = ["start_"], ["end_"], ["start_", ""], ["end_", "", "start_"], [""]
    for row, lost in enumerate(lost_of):
        for axis, at in ((a, at) for a in "xy" for at in lost):
            table[f"{axis}_{at}px"][row] = np.nan
    pq.write_table(pa.table(table), tmp_path / "truth" / "targets.parquet")
    found = frame_labels(tmp_path, 0, SHAPE)
    assert found.name.tolist() == ["t0", "t1", "t2", "t4"]
    assert found.x_start_px.tolist() == [70.0, 50.0, 90.0, 50.0]
    assert found.x_end_px.tolist() == [90.0, 70.0, 90.0, 90.0]
    assert found.x_px.tolist() == [70.0, 70.0, 90.0, 70.0]
    assert found.length_px.tolist() == [20.0, 20.0, 0.0, 40.0]


def test_angles_run_from_columns_towards_rows(tmp_path):
    """30 columns and 40 rows: 53.13 degrees; and every quadrant from start to end."""
    steps = [(30, 40), (-30, 40), (-30, -40), (30, -40), (20, 0), (0, 20), (-20, 0), (0, -20)]
    start = np.array([150.0, 50.0])
    labels = labels_of(tmp_path, [(start, start + step) for step in steps])
    expected = [53.130102, 126.869898, -126.869898, -53.130102, 0.0, 90.0, 180.0, -90.0]
    assert labels.angle_deg == pytest.approx(expected, abs=1e-6)
    assert labels.length_px.tolist() == [50.0] * 4 + [20.0] * 4


def test_labels_shine_and_reach_the_limit(tmp_path):
    """Sources without light are none; a star of just the least signal-to-noise is labelled."""
    labels_of(tmp_path, [((50, 50), (60, 60))] * 4)
    plain = pq.read_table(tmp_path / "truth" / "targets.parquet").to_pydict()
    plain |= {"electrons": [5.0, 0.0, 7.0, 6.0], "snr": [10.0, 11.0, 9.99, 12.0]}
    stars = plain | {"source_id": [11, 12, 13, 14], "g_mag": np.ones(4)}
    for kind, table in (("targets", plain), ("stars", stars)):
        pq.write_table(pa.table(table), tmp_path / "truth" / f"{kind}.parquet")
    found = frame_labels(tmp_path, 0, SHAPE, 10.0)
    assert found.name.tolist() == ["t2", "t3", "t0", "14", "11"]  # each part brightest first


def test_angle_of_a_streak_is_that_of_its_light(labelled, tmp_path):
    """The drifting satellite: its angle in the file against second moments of its drawn light."""
    (*_, coco) = export_product(labelled, "coco", tmp_path / "coco", ExportRequest(0))
    told = {a["name"]: a for a in json.loads(coco.read_text())["annotations"]}["drifter"]["streak"]
    light = read_layer(labelled, "targets_e", 0).astype(float)
    x0, y0 = np.round(told["light"]).astype(int) - 40
    cut = light[y0 : y0 + 81, x0 : x0 + 81]
    y, x = np.mgrid[: cut.shape[0], : cut.shape[1]] - 40.0
    total = cut.sum()
    x, y = x - (x * cut).sum() / total, y - (y * cut).sum() / total
    xx, yy, xy = ((a * cut).sum() / total for a in (x * x, y * y, x * y))
    angle = 0.5 * np.degrees(np.arctan2(2.0 * xy, xx - yy))
    assert np.hypot(xx - yy, 2.0 * xy) > 0.5 * (xx + yy)  # a streak that has a direction
    assert abs(abs(angle) - 45.0) > 10.0  # and would have another with its axes swapped
    assert (told["angle_deg"] - angle + 90.0) % 180.0 - 90.0 == pytest.approx(0.0, abs=0.5)


def arc(centre, radius_px, middle_deg, half_deg):
    """Start, middle and end (x, y) of an arc."""
    turns = np.radians(middle_deg + np.array([-1.0, 0.0, 1.0]) * half_deg)
    return np.array(centre) + radius_px * np.stack([np.cos(turns), np.sin(turns)], axis=-1)


def test_a_long_trail_is_kept_by_its_arc_and_not_by_its_chord(tmp_path):
    """Arcs of 60 degrees about the pole: the chord of the first passes below the frame, that of the
    second crosses it; one that a part of the exposure hides keeps its straight path."""
    trails = [arc((150, -338), 360, 90, 30), arc((150, -338), 470, 90, 30)]
    trails += [arc((150, 500), 420, -90, 130), arc((-900, 50), 1205, 0, 1.5)]
    trails += [np.array([(150, -90), (150, 20), (150, -60)], float)] * 2
    labels_of(tmp_path, [((50, 50), (60, 60))] * len(trails))
    table = pq.read_table(tmp_path / "truth" / "targets.parquet").to_pydict()
    for which, at in zip(("_start", "", "_end"), np.stack(trails, axis=1), strict=True):
        table |= {f"x{which}_px": at[:, 0], f"y{which}_px": at[:, 1]}
    table["visible_fraction"] = [1.0] * 5 + [0.2]
    pq.write_table(pa.table(table), tmp_path / "truth" / "targets.parquet")
    assert frame_labels(tmp_path, 0, SHAPE).name.tolist() == ["t0", "t2", "t4"]
    flat = frame_labels(tmp_path, 0, (200, 400)).name.tolist()
    assert flat == [f"t{i}" for i in range(5)]


def test_arcs_follow_even_turns_to_a_tenth_of_a_pixel():
    """Of 1.5 to 220 degrees, at radii to 3000 px; to and fro stays on its line, rest at rest."""
    for radius_px, half_deg in ((3000, 0.75), (500, 30), (1500, 30), (300, 110)):
        start, middle, end = arc((20, 30), radius_px, 65, half_deg)
        path = path_between(start, middle, end)
        x, y = (middle[i] + v for i, v in enumerate((path.x_px, path.y_px)))
        for at_x, at_y in ((x, y), (0.5 * (x[1:] + x[:-1]), 0.5 * (y[1:] + y[:-1]))):
            off = np.hypot(at_x - 20, at_y - 30) - radius_px
            assert np.abs(off).max() < 0.25, (radius_px, half_deg)
        steps = np.hypot(np.diff(x), np.diff(y))
        assert np.ptp(steps) < 0.01 * steps.mean() + 0.05
    back = path_between(np.zeros(2), np.array([100.0, 0.0]), np.array([10.0, 0.0]))
    assert not back.y_px.any()
    assert (back.x_px.min(), back.x_px[-1], back.segments % 2) == (-100.0, -90.0, 0)
    waits = path_between(np.zeros(2), np.zeros(2), np.array([40.0, 30.0]))
    assert np.hypot(waits.x_px[-1], waits.y_px[-1]) == pytest.approx(50.0, abs=0.2)
    assert path_between(*np.full((3, 2), 5.0)).segments == 1


def test_the_mask_and_box_of_what_hides_midway_end_where_it_does(tmp_path):
    """30 of 100 px are seen of a path whose middle is hidden; of another all is seen."""
    labels_of(tmp_path, [((50, 40), (80, 40)), ((50, 60), (150, 60))])
    table = pq.read_table(tmp_path / "truth" / "targets.parquet").to_pydict()
    table |= {"x_px": [100.0, 100.0], "visible_fraction": [0.3, 1.0], "electrons": [1e5, 1e5]}
    pq.write_table(pa.table(table), tmp_path / "truth" / "targets.parquet")
    labels = frame_labels(tmp_path, 0, SHAPE)
    boxes = [m.box for m in source_masks(labels, SourceLight(Blur(Gaussian(0.5))), SHAPE, 1e3)]
    for (row, column, height, width), y, last in zip(boxes, (40, 60), (80, 150), strict=True):
        assert abs(row + (height - 1) / 2 - y) <= 1
        assert abs(column - 50) <= 2
        assert abs(column + width - 1 - last) <= 2
    times = ExposureTimes(*[np.datetime64("2020-01-01T00:00:00", "us")] * 3, 1.0)
    part, whole = annotation(labels, times, SHAPE, 0.01, {}, 0.0)["data"]["objects"]
    assert part["x_mid"] == whole["x_mid"] == 100.5 / 300  # told all the same
    assert (part["x_min"], part["x_max"]) == (50.5 / 300, 80.5 / 300)
    assert (whole["x_min"], whole["x_max"]) == (50.5 / 300, 150.5 / 300)
    assert part["bbox_width"] == pytest.approx(0.1)
