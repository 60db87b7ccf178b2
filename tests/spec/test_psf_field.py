"""Point-spread functions over the field in a scene: what is taken, and what is refused and how."""

from __future__ import annotations

from typing import Any

import pytest

from pipeline.errors import BadInput
from pipeline.spec.load import parse_scene
from pipeline.spec.sensor.sensor import FieldPsf

Data = dict[str, Any]
G, AIRY = {"kind": "gaussian", "sigma_px": 1.0}, {"kind": "airy", "defocus_um": 5.0}
TABLE = {"kind": "table", "path": "psf.npy", "samples_per_px": 8}
VANES = {"kind": "airy", "vanes": {"count": 4, "width_m": 0.01}}


def field(**changes: Any) -> Data:
    return {
        "kind": "field", "rows_px": [0, 500.5], "columns_px": [0, 300, 767],
        "psfs": [[G, AIRY, G], [TABLE, G, AIRY]],
    } | changes  # fmt: skip


def with_psf(full: Data, psf: Data) -> Data:
    return {**full, "sensor": {**full["sensor"], "psf": psf}}


def test_a_grid_of_any_kinds_is_taken_and_kept(full: Data) -> None:
    scene = parse_scene(with_psf(full, field()))
    psf = scene.sensor.psf
    assert isinstance(psf, FieldPsf)
    assert psf.rows_px == (0.0, 500.5)
    assert [[one.kind for one in row] for row in psf.psfs][1] == ["table", "gaussian", "airy"]
    assert parse_scene(scene.as_dict()) == scene
    named = [psf.name_of("sensor.psf.sigma_px", node) for node in (2, 3, 5)]
    assert [name.split(".")[3:5] for name in named] == [["0", "2"], ["1", "0"], ["1", "2"]]
    one = {"kind": "field", "rows_px": [10], "columns_px": [20], "psfs": [[G]]}
    assert parse_scene(with_psf(full, one)).sensor.psf.kind == "field"


@pytest.mark.parametrize(
    ("changes", "name", "allowed"),
    [
        ({"rows_px": [500, 0]}, "rows_px", "increasing"),
        ({"columns_px": [0, 300, 300]}, "columns_px", "increasing"),
        ({"columns_px": [0, 300, 300.5]}, "columns_px", "1 px apart"),
        ({"rows_px": []}, "rows_px", "at least 1"),
        ({"rows_px": list(range(0, 100, 10))}, "rows_px", "at most 9"),
        ({"rows_px": [0, float("inf")]}, "rows_px.1", "finite"),
        ({"rows_px": [0, 250, 500]}, "psfs", "each of 3 rows_px"),
        ({"psfs": [[G, G, G], [G, G]]}, "psfs", "each of 3 columns_px"),
        ({"psfs": [[G, G, G], [G, G, field()]]}, "psfs.1.2.kind", "'gaussian', 'airy'"),
        ({"psfs": [[G, G, G], [G, G, {"kind": "gaussian"}]]}, "psfs.1.2.sigma_px", "be given"),
        ({"psfs": [[G, G, G], [G, TABLE, TABLE | {"includes_pixel": True}]]}, "psfs", "for all"),
        ({"psfs": [[VANES, AIRY, VANES], [VANES] * 3]}, "psfs", "the same vanes"),
        ({"jitter_px": 0.2}, "jitter_px", "known keys"),
    ],
)  # fmt: skip
def test_one_message_names_what_is_wrong(
    full: Data, changes: Data, name: str, allowed: str
) -> None:
    with pytest.raises(BadInput) as caught:
        parse_scene(with_psf(full, field(**changes)))
    text = str(caught.value)
    assert text.startswith(f"sensor.psf.{name}: ")
    assert allowed in text
    assert "\n" not in text
