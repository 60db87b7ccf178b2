"""What a job is forecast to take is told before it is queued, and bounded by a setting."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from pipeline.errors import BadInput
from pipeline.route.prepare import check_cost
from pipeline.route.run import Options, render
from pipeline.spec.load import parse_scene


def test_a_plan_and_a_submission_tell(server: Any, scene: dict[str, Any]) -> None:
    scene["exposure"]["frames"] = 3
    plan = server.client.post("/v1/jobs?dry_run=1", json=scene).json()
    assert plan["estimated_cpu_s"] == plan["predicted"]["cpu_s"]
    job = server.client.post("/v1/jobs", json=scene).json()
    assert job["least_cpu_s"] == pytest.approx(plan["estimated_cpu_s"], rel=0.1)  # no stars
    server.client.post(f"/v1/jobs/{job['id']}/cancel")


@pytest.mark.slow
def test_a_scene_over_the_limit_is_refused_over_http(
    make_server: Callable[..., Any], scene: dict[str, Any]
) -> None:
    server = make_server(NIGHTGLASS_JOB_CPU_S="30")
    scene["exposure"]["frames"] = 2000
    for query in ("", "?dry_run=1"):
        answer = server.client.post(f"/v1/jobs{query}", json=scene)
        assert answer.status_code == 422, answer.text
        [told] = answer.json()["errors"]
        assert told["pointer"] == "/exposure/frames"
        assert "at most 30 CPU s" in told["allowed"]


def test_a_plan_over_the_limit_draws_nothing(tmp_path: Any, scene: dict[str, Any]) -> None:
    """What only the plan knows is refused before the product is begun."""
    asked = parse_scene(scene)
    with pytest.raises(BadInput, match=r"^exposure\.frames: .* at most 1 CPU s \(predicted: 4\)"):
        render(asked, tmp_path / "run", Options(most_cpu_s=1.0))
    assert not (tmp_path / "run").exists()
    check_cost(asked, {"predicted": {"cpu_s": 9e9}, "frames": 1}, None)
