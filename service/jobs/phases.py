"""Phases of a job, as in IVOA UWS 1.1, and what may follow what."""

from __future__ import annotations

from enum import StrEnum


class Phase(StrEnum):
    """Phases of a job, as in IVOA UWS 1.1."""

    PENDING = "PENDING"
    QUEUED = "QUEUED"
    EXECUTING = "EXECUTING"
    COMPLETED = "COMPLETED"
    ERROR = "ERROR"
    ABORTED = "ABORTED"


P = Phase
NEXT: dict[Phase, frozenset[Phase]] = {
    P.PENDING: frozenset({P.QUEUED, P.ABORTED}),
    P.QUEUED: frozenset({P.EXECUTING, P.ABORTED}),
    P.EXECUTING: frozenset({P.COMPLETED, P.ERROR, P.ABORTED}),
    P.COMPLETED: frozenset(),
    P.ERROR: frozenset({P.QUEUED}),  # by `retry`
    P.ABORTED: frozenset(),
}
FINAL = frozenset({P.COMPLETED, P.ERROR, P.ABORTED})
MENDABLE = ("try later", "incomplete", "disk full", "fault")  # errors that are not the scene's
WAITING = (P.PENDING, P.QUEUED)
