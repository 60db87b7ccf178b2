"""Doubts that stop a render unless the scene accepts them by name; accepted, they are warnings."""

from __future__ import annotations

from pipeline.errors import BadInput
from pipeline.spec.accept import Accepted
from pipeline.spec.scene import Scene


def accept_or_refuse(
    scene: Scene, word: Accepted, field: str, found: object, allowed: str, warning: str
) -> str:
    """The warning that stands first in plan, report and product of a scene that accepts a doubt.

    Parameters
    ----------
    word : what `accept` must hold for the scene to be drawn all the same
    field, found, allowed : of the refusal otherwise: the field as the user wrote it, the value
        found there (an angle, an elevation, a bound) and what needs no acceptance
    warning : one sentence that says what is wrong in the product, with its size

    Raises
    ------
    BadInput : where the scene does not accept it
    """
    if word in scene.accept:
        return warning
    raise BadInput(field, found, f"{allowed}; or accept: [{word}] (--accept {word})")
