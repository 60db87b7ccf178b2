"""What the axes of sweeps and studies over REST may hold: nothing that a file could be named by."""

from __future__ import annotations

from pipeline.spec.load import path_holders
from pipeline.spec.sweep import Axis, ListAxis, TableAxis
from service.problems import NotAllowed

WORDS = (str, list, tuple, dict)


def check_no_file(name: str, axis: Axis) -> None:
    """NotAllowed where a value of an axis stands, or holds something, where a file could be named.

    name : of the axis, for the message
    """
    rows: tuple[tuple[object, ...], ...] = ()
    if isinstance(axis, ListAxis | TableAxis):
        rows = axis.rows if isinstance(axis, TableAxis) else tuple((v,) for v in axis.values)
    for row in rows:
        for field, value in zip(axis.fields, row, strict=True):
            if not isinstance(value, WORDS):
                continue
            placed: object = value
            for part in reversed(field.split(".")):
                placed = {part: placed}
            for at, holder, key in path_holders(placed):
                if isinstance(holder.get(key), WORDS):
                    allowed = f"numbers for {at}: over REST no axis goes through files"
                    raise NotAllowed(f"{name}: {allowed}", ((name, value, allowed),))
