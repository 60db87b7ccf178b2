#!/bin/sh
# Build the image where there is neither a registry nor an engine: the base is made of Debian's
# packages, and buildah runs each step of the Dockerfile in a chroot.
#
#     deploy/build-from-debian.sh [TAG]      # default: nightglass:latest
#
# Needs root, `apt-get install buildah debootstrap`, and 4 GB of disk. Environment:
#   MIRROR        where Debian's packages come from (http://deb.debian.org/debian)
#   EXTRA_CA      a PEM file of authorities that the build must trust beside Debian's, if any
#   BASE          an image to build on that is there already: none is made
#   STORAGE_DRIVER, CONTAINERS_STORAGE_CONF  as buildah takes them (vfs: works everywhere)
set -eu

tag=${1:-nightglass:latest}
root=$(cd "$(dirname "$0")/.." && pwd)
export STORAGE_DRIVER="${STORAGE_DRIVER:-vfs}" BUILDAH_ISOLATION=chroot

if [ -z "${BASE:-}" ]; then
    BASE=localhost/nightglass-base:bookworm
    made=$(buildah from scratch)
    trap 'buildah rm "$made" >/dev/null' EXIT
    mounted=$(buildah mount "$made")
    debootstrap --variant=minbase \
        --include=python3,python3-venv,python-is-python3,ca-certificates \
        bookworm "$mounted" "${MIRROR:-http://deb.debian.org/debian}"
    rm -rf "$mounted"/var/cache/apt/*.bin "$mounted"/var/cache/apt/archives/*.deb \
        "$mounted"/var/lib/apt/lists/*
    if [ -n "${EXTRA_CA:-}" ]; then
        cp "$EXTRA_CA" "$mounted/usr/local/share/ca-certificates/extra.crt"
        chroot "$mounted" update-ca-certificates
        printf '[global]\ncert = /etc/ssl/certs/ca-certificates.crt\n' > "$mounted/etc/pip.conf"
    fi
    buildah config --env LANG=C.UTF-8 --cmd python "$made"
    buildah commit --quiet "$made" "$BASE"
fi

# The form of docker keeps HEALTHCHECK, which the plain OCI form has no place for.
buildah bud --format docker --build-arg "BASE=$BASE" --tag "$tag" "$root"
