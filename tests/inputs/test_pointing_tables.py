"""Tables of attitudes and spectra from files: every format, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.errors import BadInput
from pipeline.inputs.pointing_tables import gather_pointing
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.spec.load import parse_scene

BASE: dict[str, Any] = {
    "schema": "nightglass/scene/1",
    "name": "table",
    "epoch": "2019-04-20T03:00:00Z",
    "observer": {"kind": "fixed", "position_au": [1.2, 0.1, 0.05]},
    "sensor": {
        "shape": [64, 64], "pixel_pitch_um": 10.0, "focal_length_m": 1.0, "aperture_m": 0.4,
        "bandpass": {"kind": "box", "short_nm": 400.0, "long_nm": 900.0},
        "psf": {"kind": "gaussian", "sigma_px": 1.0},
    },
    "exposure": {"integration_s": 2.0, "frames": 3, "cadence_s": 10.0},
}  # fmt: skip
TIME = np.arange(-5.0, 60.0, 0.5)
TURN = Rotation.from_rotvec(np.outer(1e-4 * np.sin(0.3 * TIME), [0.5, 1.0, 0.2]))
Q = TURN.as_quat()


def scene(pointing: dict[str, Any]) -> Any:
    return parse_scene(BASE | {"pointing": {"mode": "table", "frame": "gcrs"} | pointing})


def write(folder: Path, kind: str) -> Path:
    path = folder / f"attitude.{kind}"
    columns = dict(zip(("time_s", "qx", "qy", "qz", "qw"), (TIME, *Q.T), strict=True))
    if kind == "csv":
        lines = [",".join(columns), *(",".join(map(repr, map(float, r))) for r in zip(
            *columns.values(), strict=True))]  # fmt: skip
        path.write_text("\n".join(lines))
    elif kind == "npy":
        np.save(path, np.column_stack(list(columns.values())))
    elif kind == "parquet":
        import pyarrow as pa
        import pyarrow.parquet as pq

        pq.write_table(pa.table(columns), path)
    else:
        from astropy.table import Table

        Table(columns).write(path)
    return path


@pytest.mark.parametrize("kind", ["csv", "npy", "parquet", "fits"])
def test_every_kind_of_file(tmp_path: Path, kind: str) -> None:
    rows = np.column_stack([TIME, Q]).tolist()
    plain = plan_geometry(scene({"rows": rows, "scalar": "last"}), np.arange(3), 0.0)
    given = scene({"path": str(write(tmp_path, kind)), "scalar": "last"})
    made = gather_pointing(given)
    assert made.pointing.path is None  # type: ignore[union-attr]
    assert len(made.pointing.rows) < len(rows)  # type: ignore[union-attr]
    assert made.pointing.error_arcsec is not None  # type: ignore[union-attr]
    g = plan_geometry(made, np.arange(3), 0.0)
    assert np.allclose(g.attitude, plain.attitude, atol=1e-12)
    assert gather_pointing(made).pointing.rows == made.pointing.rows  # type: ignore[union-attr]


def test_times_as_utc(tmp_path: Path) -> None:
    path = tmp_path / "utc.csv"
    texts = [f"2019-04-20T03:00:{t:06.3f}Z" for t in TIME[10:]]
    lines = ["time_utc,q0,q1,q2,q3"]
    lines += [f"{t},{q[3]},{q[0]},{q[1]},{q[2]}" for t, q in zip(texts, Q[10:], strict=True)]
    path.write_text("\n".join(lines))
    made = gather_pointing(scene({"path": str(path), "scalar": "first"}))
    rows = np.array(made.pointing.rows)  # type: ignore[union-attr]
    assert np.allclose(rows[:, 0], TIME[10 : 10 + len(rows)], atol=1e-6)
    g = plan_geometry(made, np.arange(3), 0.0)
    plain = scene({"rows": np.column_stack([TIME, Q]).tolist(), "scalar": "last"})
    assert np.allclose(g.attitude, plan_geometry(plain, np.arange(3), 0.0).attitude, atol=1e-9)


def test_a_mounting_keeps_its_scalar_where_a_file_names_its_columns(tmp_path: Path) -> None:
    """The rows' scalar stands where the names say; the mounting's where the scene says."""
    path, turn = write(tmp_path, "csv"), Rotation.from_rotvec([0.3, -0.2, 0.5]).as_quat().tolist()
    last, first, unsaid = (
        plan_geometry(gather_pointing(scene({"path": str(path)} | told)), np.arange(3), 0.0)
        for told in (
            {"scalar": "last", "mounting": turn},
            {"scalar": "first", "mounting": [turn[3], *turn[:3]]},
            {"mounting": turn},
        )
    )
    np.testing.assert_array_equal(first.attitude, last.attitude)
    np.testing.assert_array_equal(unsaid.attitude, last.attitude)


HEAD = "time_s,qx,qy,qz,qw\n"
BAD = {
    "short": (HEAD + "0,0,0,0,1\n5,0,0,0,1\n", "rows over all exposures"),
    "late": (HEAD + "5,0,0,0,1\n95,0,0,0,1\n", "rows over all exposures"),
    "nan": (HEAD + "0,0,0,0,1\n50,nan,0,0,1\n", "finite numbers"),
    "falling": (HEAD + "0,0,0,0,1\n50,0,0,0,1\n40,0,0,0,1\n", "increase"),
    "norm": (HEAD + "0,0,0,0,1\n50,0,0,0,2\n", "unit quaternions"),
    "zero": (HEAD + "0,0,0,0,0\n50,0,0,0,1\n", "unit quaternions"),
    "text": (HEAD + "0,a,0,0,1\n50,0,0,0,1\n", "numbers in every column"),
    "columns": ("t,a,b,c,d\n0,0,0,0,1\n", "time_s or time_utc"),
    "uneven": (HEAD + "0,0,0,0\n", "has 4 values"),
    "empty": ("", "empty"),
    "no scalar": ("time_s,q1,q2,q3,q4\n0,0,0,0,1\n99,0,0,0,1\n", "numbers its columns"),
    "one row": (HEAD + "0,0,0,0,1\n", "two rows"),
    "column twice": ("time_s,qx,qy,qz,qw, QX\n0,0,0,0,1,0\n50,0,0,0,1,0\n", "each column once"),
}


@pytest.mark.parametrize("name", BAD)
def test_files_that_cannot_be_used(tmp_path: Path, name: str) -> None:
    text, word = BAD[name]
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(BadInput) as caught:
        gather_pointing(scene({"path": str(path)}))
    assert caught.value.field in ("pointing.path", "pointing.scalar")
    assert word in str(caught.value)


def test_rows_may_begin_and_end_with_the_exposures(tmp_path: Path) -> None:
    """Of three exposures, 10 s apart and 2 s long, the last ends at 22 s: no later row is due."""
    path = tmp_path / "tight.csv"
    path.write_text(HEAD + "0,0,0,0,1\n22,0,0,0,1\n")
    made = gather_pointing(scene({"path": str(path)}))
    assert np.array(made.pointing.rows)[:, 0].tolist() == [0.0, 22.0]  # type: ignore[union-attr]
    for rows in ("0,0,0,0,1\n21.999,0,0,0,1\n", "0.001,0,0,0,1\n22,0,0,0,1\n"):
        path.write_text(HEAD + rows)
        with pytest.raises(BadInput, match="rows over all exposures, 0 to 22 s"):
            gather_pointing(scene({"path": str(path)}))


def test_rows_are_kept_for_whatever_asks_for_them(tmp_path: Path) -> None:
    """The last row of a rolling shutter, and frames that fall into the slew to the next dwell."""
    table = {"mode": "table", "frame": "gcrs", "scalar": "last"}
    table["path"] = str(write(tmp_path, "npy"))
    plain = table | {"path": None, "rows": np.column_stack([TIME, Q]).tolist()}
    held = {"mode": "sidereal", "boresight_ra_deg": 5.0, "boresight_dec_deg": 20.0}
    slew = {"frames": 1, "pointing": held, "slew": {"duration_s": 15.0}, "start_s": 23.0}
    rolling = BASE["sensor"] | {"detector": {"readout": {"kind": "rolling", "line_s": 0.2}}}
    for frames, more in ((3, {"sensor": rolling}), (4, {"dwells": [{"frames": 3}, slew]})):
        filed, given = (
            plan_geometry(gather_pointing(made), np.arange(frames), 0.0)
            for made in (parse_scene(BASE | more | {"pointing": p}) for p in (table, plain))
        )
        np.testing.assert_allclose(filed.attitude, given.attitude, atol=1e-12)


def test_files_that_are_no_tables(tmp_path: Path) -> None:
    for name, raw in (("a.fits", b"x"), ("a.parquet", b"x"), ("a.npy", b"x"), ("a.doc", b"x")):
        path = tmp_path / name
        path.write_bytes(raw)
        with pytest.raises(BadInput, match=r"pointing\.path"):
            gather_pointing(scene({"path": str(path)}))
    pairs = [(name, "f8", (2,)) for name in ("qx", "qy", "qz", "qw")]
    np.save(tmp_path / "a.npy", np.zeros(2, [("time_s", "f8"), *pairs]))
    with pytest.raises(BadInput, match=r"numbers in every column; each row holds \(2,\)"):
        gather_pointing(scene({"path": str(tmp_path / "a.npy")}))
    with pytest.raises(BadInput, match="existing file"):
        gather_pointing(scene({"path": str(tmp_path / "none.csv")}))


def test_a_spectrum_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "psd.csv"
    path.write_text("frequency_hz,arcsec2_per_hz\n0.1,1\n10,0.01\n")
    held = {"mode": "sidereal", "boresight_ra_deg": 1.0, "boresight_dec_deg": 2.0}
    jitter = [{"kind": "table", "path": str(path)}]
    made = gather_pointing(parse_scene(BASE | {"pointing": held | {"attitude": {
        "jitter": jitter}}}))  # fmt: skip
    part = made.pointing.attitude.jitter[0]  # type: ignore[union-attr]
    assert part.frequency_hz == (0.1, 10.0)  # type: ignore[union-attr]
    path.write_text("frequency_hz,arcsec2_per_hz\n1,1\n0.5,0.01\n")
    with pytest.raises(BadInput, match="increasing frequencies"):
        gather_pointing(parse_scene(BASE | {"pointing": held | {"attitude": {"jitter": jitter}}}))


@pytest.mark.parametrize("zero_s", [-40.0, 7.5])
def test_seconds_count_from_the_tables_own_epoch(tmp_path: Path, zero_s: float) -> None:
    """Rows of a file, and rows in the scene: the same attitudes, the same error between rows.

    Rows beside the exposures are noisy: they count only where the wrong ones are looked at.
    """
    rough = np.where((TIME > 30.0) | (TIME < -2.0), 1e-3, 0.0) * (-1.0) ** np.arange(len(TIME))
    q = (TURN * Rotation.from_rotvec(np.outer(rough, [1.0, 0.0, 0.0]))).as_quat()
    plain = {"rows": np.column_stack([TIME, q]).tolist(), "scalar": "last"}
    zero = f"2019-04-20T{'02:59:20' if zero_s < 0 else '03:00:07.5'}Z"
    shifted = np.column_stack([TIME - zero_s, q])
    np.save(tmp_path / "a.npy", shifted)
    filed = {"path": str(tmp_path / "a.npy"), "scalar": "last", "epoch": zero}
    given = {"rows": shifted.tolist(), "scalar": "last", "epoch": zero}
    wanted, *found = (gather_pointing(scene(p)) for p in (plain, filed, given))
    g = plan_geometry(wanted, np.arange(3), 0.0)
    assert wanted.pointing.error_arcsec < 1.0
    for made in found:
        assert np.allclose(plan_geometry(made, np.arange(3), 0.0).attitude, g.attitude, atol=1e-12)
        assert made.pointing.error_arcsec == pytest.approx(wanted.pointing.error_arcsec, rel=1e-6)
