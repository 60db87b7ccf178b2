#!/bin/sh
# Run an image as compose.yaml and the Kubernetes files promise it runs: another user than root, no
# capability, a read-only root, /tmp and /data alone to write to, and no network but loopback. Then
# ask it for its health and for one small render, twice: by the service and by the command line.
#
#     deploy/try-image.sh [TAG]      # default: nightglass:latest
#
# Needs root, buildah and util-linux (unshare, setpriv); leaves nothing behind.
set -eu

tag=${1:-nightglass:latest}
export STORAGE_DRIVER="${STORAGE_DRIVER:-vfs}" BUILDAH_ISOLATION=chroot
made=$(buildah from --pull-never "$tag")
work=$(mktemp -d)
trap 'buildah rm "$made" >/dev/null; rm -rf "$work"' EXIT
root=$(buildah mount "$made")

echo "config: $(buildah inspect --type image --format \
    '{{.Docker.Config.User}} {{.Docker.Config.Entrypoint}} {{.Docker.Config.Cmd}} {{.Docker.Config.WorkingDir}}' "$tag")"
buildah inspect --type image --format '{{range .Docker.Config.Env}}{{println .}}{{end}}' "$tag" |
    sed '/^$/d' > "$work/environment"
install -d -o 10001 -g 10001 "$work/data"
cat > "$work/data/scene.json" <<'SCENE'
{"schema": "nightglass/scene/1", "name": "image", "epoch": "2019-04-20T03:00:00Z", "seed": 7,
 "observer": {"kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3},
 "sensor": {"shape": [64, 64], "pixel_pitch_um": 13.5, "focal_length_m": 1.0, "aperture_m": 0.4,
   "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
   "psf": {"kind": "gaussian", "sigma_px": 1.0}, "read_noise_e": 5.0},
 "pointing": {"mode": "sidereal", "boresight_ra_deg": 100.0, "boresight_dec_deg": 20.0},
 "exposure": {"integration_s": 2.0, "frames": 2, "cadence_s": 5.0},
 "background": {"uniform_mag_arcsec2": 21.5}}
SCENE
cat > "$work/data/ask.py" <<'ASK'
import json, os, pathlib, sys, time, urllib.request as u
status = pathlib.Path("/proc/self/status").read_text()
held = dict(line.split(":\t", 1) for line in status.splitlines() if ":\t" in line)
assert os.getuid() == 10001 and int(held["CapEff"], 16) == int(held["CapBnd"], 16) == 0
for place in ("/", "/opt/nightglass", "/etc", "/usr/bin"):
    try:
        open(f"{place}/x", "w")
        sys.exit(f"{place} can be written")
    except OSError:
        pass
def ask(path, data=None):
    headers = {"content-type": "application/json"} if data else {}
    with u.urlopen(u.Request("http://127.0.0.1:8765" + path, data, headers), timeout=5) as answer:
        return json.loads(answer.read() or b"{}")
for _ in range(600):
    try:
        print("health:", ask("/healthz"))
        break
    except OSError:
        time.sleep(0.2)
job = ask("/v1/jobs", pathlib.Path("/data/scene.json").read_bytes())
for _ in range(600):
    job = ask("/v1/jobs/" + job["id"])
    if job["phase"] in ("COMPLETED", "ERROR", "ABORTED"):
        break
    time.sleep(0.5)
print("job:", job["phase"], job.get("content_digest"), job.get("error") or "")
sys.exit(job["phase"] != "COMPLETED")
ASK
cat > "$work/inside.sh" <<'INSIDE'
set -eu
mount --bind "$1" "$1"
mount -o remount,ro,bind "$1"
mount -t proc proc "$1/proc"
mount -t tmpfs -o size=64m,mode=1777 tmpfs "$1/tmp"
mount -t tmpfs -o size=1m,mode=755 tmpfs "$1/dev"
for each in null zero random urandom; do
    : > "$1/dev/$each"
    mount --bind "/dev/$each" "$1/dev/$each"
done
mount --bind "$2/data" "$1/data"
ip link set lo up 2>/dev/null || python3 -c 'import fcntl, socket, struct
s = socket.socket(); fcntl.ioctl(s, 0x8914, struct.pack("16sh", b"lo", 1 | 64))'
enter() { # in place of this shell; chroot needs a capability: it comes first, then none is left
    # shellcheck disable=SC2046
    exec env -i $(cat "$2/environment") HOME=/data chroot "$1" /usr/bin/setpriv --reuid 10001 \
        --regid 10001 --clear-groups --no-new-privs --bounding-set=-all --inh-caps=-all -- \
        sh -c "cd /data; exec $3"
}
enter "$1" "$2" "nightglass serve --home /data" &
served=$!
(enter "$1" "$2" "python ask.py") || { kill "$served"; exit 1; }
kill -TERM "$served"
ended=0
wait "$served" || ended=$?
[ "$ended" -eq 143 ] || { echo "the service ended with $ended, not by SIGTERM"; exit 1; }
(enter "$1" "$2" "nightglass render scene.json -o run1")
(enter "$1" "$2" "nightglass check run1")
(enter "$1" "$2" "dask scheduler --version")
INSIDE
unshare --mount --pid --fork --net --kill-child --propagation private \
    sh "$work/inside.sh" "$root" "$work"
