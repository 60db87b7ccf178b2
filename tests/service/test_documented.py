"""What docs/service.md says of catalogues, and of keys with pyvo and owslib, done as it says."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "service.md"


def test_a_catalogue_is_registered_by_its_folder(
    make_server: Callable[..., Any], scene: dict[str, Any], tmp_path: Path
) -> None:
    server = make_server()
    [line] = re.findall(
        r"(?m)^    nightglass (catalog demo -o) /srv/nightglass/(\S+)$", PAGE.read_text()
    )
    command = [sys.executable, "-m", "pipeline", *line[0].split(), str(server.home / line[1])]
    subprocess.run([*command, "--faintest", "4"], check=True, capture_output=True)
    (server.home / "catalogues" / "linked").symlink_to(server.home / line[1])
    (server.home / "catalogues" / "nothing").mkdir()
    found = server.client.get("/v1/catalogues").json()["catalogues"]
    assert [(c["name"], c["usable"]) for c in found] == [("demo", True), ("linked", True)]
    for name, status in (("demo", 202), ("linked", 202), ("nothing", 422)):
        scene["stars"] = {"catalogue": name, "faintest_g_mag": 4.0}
        answer = server.client.post("/v1/jobs", json=scene)
        assert answer.status_code == status, answer.text


@pytest.mark.parametrize("client", ["pyvo", "owslib"])
def test_keys_with_other_clients(
    make_server: Callable[..., Any], scene: dict[str, Any], client: str, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    server = make_server()
    [key] = server.make_keys("red")
    (tmp_path / "scene.yaml").write_text(json.dumps(scene))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("NIGHTGLASS_KEY", key)
    codes = re.findall(r"(?s)```python\n(.*?)```", PAGE.read_text())
    [code] = [code for code in codes if client in code]
    given: dict[str, Any] = {"scene": scene}
    exec("import os\n" + code.replace("http://127.0.0.1:8765", server.url), given)
    headers = {"authorization": f"Bearer {key}"}
    if client == "pyvo":
        assert given["job"].phase == "COMPLETED"
        assert len(given["files"]) > 3
        assert given["session"].get(given["files"]["access_url"][0]).status_code == 200
    else:
        told = server.client.get(f"/ogc/jobs/{given['job']}", headers=headers).json()
        assert told["processID"] == "render"
    [job] = server.client.get("/v1/jobs", headers=headers).json()["jobs"]
    assert job["owner"] == f"key:{key[3:15]}"
