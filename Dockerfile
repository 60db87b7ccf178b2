# Nightglass as an image: the command line and the service, non-root, read-only root.
# Every package is pinned by hash; nothing but the lock files decides what is installed.
# BASE: any image with Python 3.11 as `python`, its venv, and CA certificates;
# deploy/build-from-debian.sh makes one of Debian's packages alone.
ARG BASE=python:3.11-slim

FROM ${BASE} AS build
ENV PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_NO_CACHE_DIR=1
WORKDIR /src
COPY requirements.lock ./
# The build tools are the few of the lock that make a wheel; the image itself has none of them.
RUN awk '/^[a-z]/ {keep = /^(hatchling|packaging|pathspec|pluggy|tomlkit|trove-classifiers)==/} keep' \
        requirements.lock > build.lock \
    && python -m venv /build \
    && /build/bin/pip install --require-hashes -r build.lock \
    && python -m venv /opt/nightglass \
    && /opt/nightglass/bin/pip install --require-hashes -r requirements.lock
COPY pyproject.toml README.md LICENSE nightglass.py ./
COPY catalog_tools catalog_tools
COPY pipeline pipeline
COPY service service
RUN /build/bin/pip wheel --no-deps --no-build-isolation -w dist . \
    && /opt/nightglass/bin/pip install --no-deps --no-index dist/*.whl \
    && /opt/nightglass/bin/python -m compileall -q /opt/nightglass

FROM ${BASE}
LABEL org.opencontainers.image.title="nightglass" \
      org.opencontainers.image.licenses="BSD-3-Clause"
RUN groupadd --gid 10001 nightglass \
    && useradd --uid 10001 --gid 10001 --no-create-home --home-dir /data --shell /usr/sbin/nologin nightglass \
    && install -d -o 10001 -g 10001 /data
COPY --from=build /opt/nightglass /opt/nightglass
# What numba compiles lies on the volume.
ENV PATH=/opt/nightglass/bin:$PATH \
    PYTHONUNBUFFERED=1 \
    PYTHONDONTWRITEBYTECODE=1 \
    NIGHTGLASS_HOME=/data \
    NIGHTGLASS_CACHE=/data/cache \
    NUMBA_CACHE_DIR=/data/cache/numba
USER 10001:10001
WORKDIR /data
VOLUME /data
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=30s --timeout=5s --start-period=20s --retries=3 \
    CMD ["python", "-c", "import os, ssl, urllib.request; urllib.request.urlopen('http%s://127.0.0.1:8765/healthz' % ('s' * bool(os.environ.get('NIGHTGLASS_TLS_CERT'))), timeout=4, context=ssl._create_unverified_context())"]
ENTRYPOINT ["nightglass"]
CMD ["serve", "--home", "/data"]
