"""Every file in deploy/, and the Dockerfile, by the tool that knows its kind."""

from __future__ import annotations

import http.server
import importlib.util
import json
import os
import re
import shutil
import sqlite3
import ssl
import subprocess
import sys
import threading
import tomllib
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from tests.tls_cluster import FILES, make_certificates

ROOT = Path(__file__).resolve().parents[2]
DEPLOY = ROOT / "deploy"
BASE = DEPLOY / "kubernetes" / "base"
OVERLAYS = sorted((DEPLOY / "kubernetes" / "overlays").iterdir())
MANIFESTS = sorted(
    p for p in DEPLOY.glob("kubernetes/**/*.yaml") if p.name != "kustomization.yaml"
)  # fmt: skip
SHELL = sorted([*DEPLOY.glob("**/*.sh"), *DEPLOY.glob("**/*.sbatch")])


def tool(name: str) -> str:
    beside = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    found = shutil.which(name, path=beside)
    if found is None:
        pytest.skip(f"{name} is not installed")
    return found


def needs(module: str) -> Any:
    if importlib.util.find_spec(module) is None:
        pytest.skip(f"{module} is not installed")
    return importlib.import_module(module)


def documents(path: Path) -> list[dict[str, Any]]:
    reader = YAML(typ="safe", pure=True)
    return [d for d in reader.load_all(path.read_text()) if d]


def test_dockerfile():
    result = subprocess.run(
        [tool("hadolint"), str(ROOT / "Dockerfile")], capture_output=True, text=True
    )
    assert result.returncode == 0, result.stdout + result.stderr
    text = (ROOT / "Dockerfile").read_text()
    assert text.count("\nFROM ") == 2
    assert re.search(r"\nUSER 10001:10001\n", text)
    installs = re.findall(r"pip install [^\n&]+", text)
    assert installs
    assert all("--require-hashes" in line or "--no-index" in line for line in installs)


def test_dockerfile_copies_what_the_context_holds():
    ignored = (ROOT / ".dockerignore").read_text().splitlines()
    for line in re.findall(r"(?m)^COPY (?!--from)(.+)$", (ROOT / "Dockerfile").read_text()):
        for name in line.split()[:-1]:
            assert (ROOT / name).exists(), name
            assert f"!{name}" in ignored


def test_the_image_has_what_its_settings_can_ask_for():
    """A job table in PostgreSQL, catalogues and products in S3, meshes: its root is read-only."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    pinned = {line.split("==")[0] for line in (ROOT / "requirements.lock").read_text().splitlines()}
    for extra in ("mesh", "postgresql", "remote"):
        for wanted in project["optional-dependencies"][extra]:
            assert re.split(r"[\[><=]", wanted)[0] in pinned, wanted


def test_compose():
    models = needs("compose_spec")
    (data,) = documents(DEPLOY / "compose" / "compose.yaml")
    plain = {k: v for k, v in data.items() if not k.startswith("x-")}
    made = models.ComposeSpecification.model_validate(plain)
    assert set(made.services) == {"scheduler", "worker", "api"}
    text = re.sub(r"\$\{\w+:-([^}]*)\}", r"\1", json.dumps(plain))  # as compose fills them in
    whole = models.PyCompose.from_json(text)
    whole.validate_networks()
    whole.validate_secrets()
    whole.validate_volumes()
    with pytest.raises(ValueError, match="read_onl"):
        models.PyCompose.from_json(text.replace('"read_only"', '"read_onl"'))
    for service in data["services"].values():
        assert service["read_only"] is True
        assert service["cap_drop"] == ["ALL"]
        assert service["user"] == "10001:10001"
        for secret in service["secrets"]:
            assert secret in data["secrets"]
    assert list(data["volumes"]) == ["data"]
    assert data["networks"]["cluster"] == {"internal": True}
    published = [p for s in data["services"].values() for p in s.get("ports", [])]
    assert published == ["${NIGHTGLASS_BIND:-127.0.0.1}:8765:8765"]


@pytest.mark.parametrize("path", MANIFESTS, ids=lambda p: f"{p.parent.name}-{p.stem}")
def test_kubernetes_manifests(path):
    validator = needs("kubernetes_validate")
    for document in documents(path):
        validator.validate(document, "1.31", strict=True)


def test_kubernetes_pods_are_restricted():
    """As the namespace demands, and each volume and secret that is mounted is named."""
    pods = [d["spec"]["template"]["spec"] for p in MANIFESTS for d in documents(p)
            if d["kind"] == "Deployment"]  # fmt: skip
    assert len(pods) == 3
    for pod in pods:
        assert pod["automountServiceAccountToken"] is False
        assert pod["securityContext"]["runAsNonRoot"] is True
        assert pod["securityContext"]["seccompProfile"] == {"type": "RuntimeDefault"}
        volumes = {v["name"] for v in pod["volumes"]}
        for container in pod["containers"]:
            context = container["securityContext"]
            assert context["readOnlyRootFilesystem"] is True
            assert context["allowPrivilegeEscalation"] is False
            assert context["capabilities"] == {"drop": ["ALL"]}
            assert "memory" in container["resources"]["limits"]
            assert {m["name"] for m in container["volumeMounts"]} <= volumes


def test_kubernetes_network_is_closed_but_for_what_is_named():
    policies = [d for d in documents(BASE / "network.yaml") if d["kind"] == "NetworkPolicy"]
    deny = next(p for p in policies if p["metadata"]["name"] == "deny-all")
    assert deny["spec"] == {"podSelector": {}, "policyTypes": ["Ingress", "Egress"]}
    scheduler = next(p for p in policies if p["metadata"]["name"] == "scheduler")
    (rule,) = scheduler["spec"]["ingress"]
    (who,) = rule["from"][0]["podSelector"]["matchExpressions"]
    assert sorted(who["values"]) == ["api", "worker"]


def test_every_pod_may_be_evicted():
    """One that must stay where there is one alone keeps its node from being drained."""
    budgets = [d["spec"] for p in MANIFESTS for d in documents(p)
               if d["kind"] == "PodDisruptionBudget"]  # fmt: skip
    assert [b.get("maxUnavailable") for b in budgets] == [1]
    assert not any("minAvailable" in b for b in budgets)


@pytest.mark.parametrize("folder", [BASE, *OVERLAYS], ids=lambda p: p.name)
def test_kustomizations(folder):
    """Every file is named once and every patch has its target; kubectl builds it where it is."""
    (made,) = documents(folder / "kustomization.yaml")
    resources = made["resources"]
    assert all((folder / name).exists() for name in resources)
    files = {p.name for p in folder.glob("*.yaml")} - {"kustomization.yaml"}
    assert files == {name for name in resources if name.endswith(".yaml")}
    known = {(d["kind"], d["metadata"]["name"]) for p in MANIFESTS for d in documents(p)}
    for patch in made.get("patches", []):
        assert (patch["target"]["kind"], patch["target"]["name"]) in known
    kubectl = shutil.which("kubectl")
    if kubectl is not None:  # it reads files alone: no cluster is asked
        built = subprocess.run([kubectl, "kustomize", str(folder)], capture_output=True, text=True)
        assert built.returncode == 0, built.stderr
        validator = needs("kubernetes_validate")
        for document in YAML(typ="safe", pure=True).load_all(built.stdout):
            validator.validate(document, "1.31", strict=True)
            if document["kind"] != "Namespace":
                assert document["metadata"]["namespace"] == "nightglass"


@pytest.mark.parametrize("path", SHELL, ids=lambda p: p.name)
def test_shell_scripts(path):
    result = subprocess.run([tool("shellcheck"), str(path)], capture_output=True, text=True)
    assert result.returncode == 0, result.stdout


def test_certificates_name_hosts_and_addresses(tmp_path):
    hosts = ["sky.example.org", "4.example.org", "10.1.2.3", "fd00::7"]
    made = [str(DEPLOY / "tls" / "make-certificates.sh"), str(tmp_path), *hosts]
    shown = [tool("openssl"), "x509", "-in", str(tmp_path / "api.pem"), "-noout", "-ext"]
    subprocess.run(made, check=True, capture_output=True)
    told = subprocess.run([*shown, "subjectAltName"], check=True, capture_output=True, text=True)
    for name in ("DNS:sky.example.org", "DNS:4.example.org", "IP Address:10.1.2.3",
                 "IP Address:FD00:0:0:0:0:0:0:7"):  # fmt: skip
        assert f"{name}," in told.stdout


@pytest.mark.parametrize("tasks", [{"MIN": "3"}, {"STEP": "2"}, {"ID": "1", "COUNT": "2"}])
def test_a_few_parts_run_again_say_of_how_many_they_are(tmp_path, tasks):
    """Tasks 3 to 8 alone, or 1 and 8, may be of 64: without PARTS nothing is drawn."""
    given = {"ID": "3", "MAX": "8", "MIN": "1", "STEP": "1"} | tasks
    given = {f"SLURM_ARRAY_TASK_{name}": value for name, value in given.items()}
    script = ["bash", str(DEPLOY / "slurm" / "array.sbatch"), "scene.json", str(tmp_path / "run")]
    environ = {"PATH": os.environ["PATH"], "USER": "me", **given}
    result = subprocess.run(script, env=environ, capture_output=True, text=True)
    assert result.returncode != 0
    assert "set PARTS=N" in result.stderr


@pytest.mark.slow
def test_slurm_array_runs_without_slurm(tmp_path):
    """The array's script itself, its tasks side by side as Slurm would start them; one repeated."""
    scene = {
        "schema": "nightglass/scene/1", "name": "a", "epoch": "2019-07-20T09:00:00Z",
        "observer": {"kind": "fixed", "position_au": [1, 0, 0]},
        "sensor": {
            "shape": [256, 512], "pixel_pitch_um": 9.0, "focal_length_m": 0.5, "aperture_m": 0.1,
            "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
            "psf": {"kind": "gaussian", "sigma_px": 0.8}},
        "pointing": {"mode": "sidereal", "boresight_ra_deg": 10.0, "boresight_dec_deg": 5.0},
        "exposure": {"integration_s": 1.0, "frames": 2},
        "background": {"uniform_e_per_s": 90.0}, "output": {"tile_shape": [256, 256]},
    }  # fmt: skip
    (tmp_path / "scene.json").write_text(json.dumps(scene))
    command = tmp_path / "bin" / "nightglass"
    command.parent.mkdir()
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m pipeline "$@"\n')
    command.chmod(0o755)
    environ = os.environ | {"PATH": f"{command.parent}:{os.environ['PATH']}"}
    environ |= {"SLURM_ARRAY_TASK_MAX": "3", "SLURM_CPUS_PER_TASK": "1"}
    environ.pop("USER", None)  # as in containers
    product = tmp_path / "run"

    def start(part: int) -> subprocess.Popen:
        script = ["bash", str(DEPLOY / "slurm" / "array.sbatch"), str(tmp_path / "scene.json")]
        own = environ | {"SLURM_ARRAY_TASK_ID": str(part)}
        return subprocess.Popen([*script, str(product)], env=own, stderr=subprocess.PIPE, text=True)

    for one in [start(1), start(2), start(3)]:
        _, err = one.communicate(timeout=300)
        assert one.returncode == 0, err
    join = ["bash", str(DEPLOY / "slurm" / "join.sbatch"), str(product)]
    result = subprocess.run(join, env=environ, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    assert "whole, 4 of 4 tiles" in result.stdout


@pytest.mark.parametrize("tls", [False, True])
def test_the_image_is_healthy_over_tls_too(tls: bool, tmp_path: Path) -> None:
    """Its check against a server that speaks TLS where a certificate is set, and only then."""
    found = re.search(r"HEALTHCHECK .*?CMD (\[.*?\])\n", (ROOT / "Dockerfile").read_text(), re.S)
    assert found
    server = http.server.HTTPServer(("127.0.0.1", 0), http.server.SimpleHTTPRequestHandler)
    if tls:
        make_certificates(tmp_path, "localhost")
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(tmp_path / FILES["CERT"], tmp_path / FILES["KEY"])
        server.socket = context.wrap_socket(server.socket, server_side=True)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    asks = [
        part.replace("8765/healthz", f"{server.server_port}/") for part in json.loads(found[1])
    ]
    for given in ({}, {"NIGHTGLASS_TLS_CERT": "x"}):
        done = subprocess.run(
            [sys.executable, *asks[1:]], env=os.environ | given, capture_output=True, cwd=tmp_path
        )
        assert (done.returncode == 0) == (tls == bool(given)), done.stderr
    server.shutdown()


def test_a_second_backup_holds_what_came_since_the_first(tmp_path):
    """The runbook's own lines, but for the containers."""
    text = (DEPLOY / "runbook.md").read_text()
    before, _, _ = text[text.index("## Back up") :].partition("    docker run")
    commands = "\n".join(line for line in before.splitlines() if line.startswith("    C exec api "))
    commands = commands.replace("C exec api ", "").replace("/data/", f"{tmp_path}/") + " true"
    commands = commands.replace("python -c", f"{sys.executable} -c")
    with sqlite3.connect(tmp_path / "jobs.sqlite") as table:
        table.execute("CREATE TABLE jobs (id)")
        for rows in (1, 2):
            table.execute("INSERT INTO jobs VALUES (1)")
            table.commit()
            subprocess.run(["bash", "-c", commands], check=True)
            with sqlite3.connect(tmp_path / "jobs.backup") as backup:
                assert backup.execute("SELECT COUNT(*) FROM jobs").fetchone() == (rows,)
