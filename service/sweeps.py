"""Sweeps over REST: what a submission must look like, and which function runs one."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

from service.problems import NotAllowed
from service.scenes import HasFile, accept_scene
from service.settings import Settings

# (module, function) that the worker calls: function(order, listen) -> {"tiles", "content_digest"}
RUN = ("pipeline.sweep.job", "run_sweep_job")
SCHEMA = "nightglass/sweep/1"


def can_run() -> bool:
    """Whether this installation holds the runner of sweeps."""
    try:
        return find_spec(RUN[0]) is not None
    except ModuleNotFoundError:
        return False


def accept_sweep(data: Any, settings: Settings, has_file: HasFile | None = None) -> dict[str, Any]:
    """A sweep as it is stored: its base scene is looked at like any other scene."""
    if not can_run():
        raise NotAllowed("sweeps cannot be run by this installation")
    if not isinstance(data, dict) or data.get("schema") != SCHEMA:
        given = data.get("schema") if isinstance(data, dict) else data
        raise NotAllowed("schema: not a sweep", (("schema", given, SCHEMA),))
    base = accept_scene(data.get("base"), settings, has_file)
    return data | {"base": base.as_dict()}
