"""Every limit of the schema: what the message says is what is accepted, on the limit and beyond."""

from __future__ import annotations

import math
import typing
from collections.abc import Iterator
from typing import Annotated, Any

import annotated_types as at
import pytest
from pydantic import BaseModel, TypeAdapter, ValidationError

from pipeline.spec.load import InvalidScene, mistakes_of, parse_scene
from pipeline.spec.scene import Scene

WORDS = {
    at.Ge: "greater than or equal to {0}", at.Gt: "greater than {0}",
    at.Le: "less than or equal to {0}", at.Lt: "less than {0}",
}  # fmt: skip


def leaves(kind: Any, name: str, found: list[Any], seen: set[Any]) -> Iterator[tuple[str, Any]]:
    """(where, annotated number) of every number with limits, in unions, lists and models."""
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        if kind not in seen:
            seen.add(kind)
            for key, field in kind.model_fields.items():
                yield from leaves(field.annotation, f"{kind.__name__}.{key}", field.metadata, seen)
    elif typing.get_origin(kind) is Annotated:
        inner, *more = typing.get_args(kind)
        yield from leaves(inner, name, [*found, *more], seen)
    elif kind in (int, float):
        flat = [m for f in found for m in (getattr(f, "metadata", None) or [f])]
        limits = [m for m in flat if isinstance(m, tuple(WORDS))]
        for limit in limits:
            yield name, (kind, limit, limits)
    else:
        own = [] if typing.get_origin(kind) in (tuple, list, dict) else found
        for inner in typing.get_args(kind):
            yield from leaves(inner, name, own, seen)


LIMITS = list(leaves(Scene, "", [], set()))


def said(adapter: TypeAdapter[Any], value: float) -> str | None:
    """What a refusal says is allowed; None where the value is accepted."""
    try:
        adapter.validate_python(value)
    except ValidationError as error:
        ((_, _, allowed),) = mistakes_of(error, {})
        return allowed
    return None


def test_every_limit_means_what_it_says():
    assert len(LIMITS) > 300
    for name, (kind, limit, limits) in LIMITS:
        bound = getattr(limit, type(limit).__name__.lower())
        up = isinstance(limit, at.Le | at.Lt)
        away = math.inf if up else -math.inf
        beyond = bound + (1 if up else -1) if kind is int else math.nextafter(float(bound), away)
        adapter = TypeAdapter(Annotated[kind, *limits])
        inclusive = isinstance(limit, at.Ge | at.Le)
        on, over = said(adapter, bound), said(adapter, beyond)
        assert (on is None) == inclusive, (name, bound, on)
        assert over is not None, (name, beyond)
        prefix = "allowed: " + WORDS[type(limit)].format("")
        for message in [over] if inclusive else [on, over]:
            assert message.startswith(prefix), (name, message)
            assert float(message.removeprefix(prefix).split(",")[0]) == pytest.approx(bound), name


def test_every_number_has_limits():
    """A number without them lets 1e300 in; these have their own checks, or come from us."""
    bounded = {name for name, _ in LIMITS}
    free = {
        "TableOrbit.rows", "TpvDistortion.pv1", "TpvDistortion.pv2", "SystemMode.a", "SystemMode.b",
        "SystemMode.c",
    }  # fmt: skip
    for model in models(Scene, set()):
        for key, field in model.model_fields.items():
            if has_number(field.annotation):
                name = f"{model.__name__}.{key}"
                assert name in bounded or name in free, name


def models(kind: Any, seen: set[Any]) -> set[Any]:
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        if kind not in seen:
            seen.add(kind)
            for field in kind.model_fields.values():
                models(field.annotation, seen)
    else:
        for inner in typing.get_args(kind):
            models(inner, seen)
    return seen


def has_number(kind: Any) -> bool:
    if typing.get_origin(kind) is typing.Literal:
        return False
    return kind in (int, float) or any(has_number(k) for k in typing.get_args(kind))


BASE = {
    "schema": "nightglass/scene/1", "name": "limits", "epoch": "2015-07-02T12:00:00Z",
    "observer": {"kind": "fixed", "position_au": [0.9, 0.4, 0.1]},
    "sensor": {
        "shape": [64, 64], "pixel_pitch_um": 10.0, "focal_length_m": 0.4, "aperture_m": 0.1,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 1.0},
    },
    "pointing": {"mode": "sidereal", "boresight_ra_deg": 101.0, "boresight_dec_deg": 30.0},
    "exposure": {"integration_s": 1.0},
}  # fmt: skip


@pytest.mark.parametrize(
    ("section", "key", "value", "word"),
    [
        ("sensor", "bias_dn", -1e18, "-65536 to 131072"),
        ("sensor", "bias_dn", 1e6, "-65536 to 131072"),
        ("sensor", "gain_e_per_dn", 1e12, "less than or equal to 1000000"),
        ("sensor", "flat", 0.0, "greater than or equal to 0.000001"),
        ("sensor", "quantum_efficiency", 0.0, "greater than 0"),
        ("sensor", "transmission", 0.0, "greater than 0"),
        ("pointing", "roll_deg", 1e300, "less than or equal to 360"),
        ("output", "layers", [], "at least 1 item"),
        ("exposure", "cadence_s", 1e300, "less than or equal to 1000000000"),
        ("sensor", "shape", [1, 2, 3], "at most 2 items"),
        ("sensor", "flat", "", "at least 1 character"),
    ],
)
def test_absurd_values_are_refused(section, key, value, word):
    scene = BASE | {section: BASE.get(section, {}) | {key: value}}
    with pytest.raises(InvalidScene) as caught:
        parse_scene(scene)
    (mistake,) = caught.value.mistakes
    assert mistake[0] == f"{section}.{key}"
    assert mistake[2].startswith("allowed: ")
    assert word in mistake[2]
    assert not any(theirs in mistake[2] for theirs in ("Tuple", "String", "Input", "valid"))


def test_a_list_is_not_too_short_because_its_item_is_wrong():
    with pytest.raises(InvalidScene) as caught:
        parse_scene(BASE | {"dwells": [{"integration_s": -1}]})
    assert [field for field, *_ in caught.value.mistakes] == ["dwells.0.integration_s"]


def test_each_dwell_points_at_a_target_that_is_there():
    ball = {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.2}
    orbit = {"kind": "state", "position_m": [7e6, 0, 0], "velocity_m_s": [0, 7500, 0]}
    scene = BASE | {"targets": [{"name": "one", "orbit": orbit, "body": ball}]}
    at = [{"pointing": {"mode": "target", "target": name}} for name in ("one", "other")]
    parse_scene(scene | {"dwells": at[:1]})
    with pytest.raises(InvalidScene) as caught:
        parse_scene(scene | {"dwells": at})
    assert caught.value.mistakes == [
        ("dwells.1.pointing.target", "other", "allowed: the name of a target: one")
    ]
