"""Frames of a job: tiles as values or pictures (also while it is drawn), WCS, truth, downloads."""

from __future__ import annotations

import re
from pathlib import Path
from threading import BoundedSemaphore
from typing import Annotated, Any, Literal

import numpy as np
from fastapi import APIRouter, Depends, Query
from fastapi import Path as InPath
from fastapi.responses import JSONResponse, Response, StreamingResponse

from pipeline.store import layout
from pipeline.store.seal import check_complete
from service.context import Context, Service
from service.problems import NotThere
from service.products import frames
from service.products.archive import archive
from service.routes.results import _product as complete_product
from service.routes.results import scene_job, whole_product

router = APIRouter(prefix="/v1/jobs/{job_id}", tags=["frames"])
Number = Annotated[int, InPath(ge=0, lt=2**31)]
FOR_GOOD = {"Cache-Control": "private, max-age=3600, immutable"}  # a drawn tile never changes
reading = BoundedSemaphore(2)  # tiles and frames in memory at once


def _begun_product(service: Context, job_id: str) -> Path:
    """The product of a job, complete or not."""
    return service.settings.product(scene_job(service, job_id).id)


def _whole_product(service: Context, job_id: str) -> Path:
    """The product of a job that has drawn all of its frames."""
    return whole_product(service, scene_job(service, job_id))


def _pixels() -> Any:
    """What reads and draws frames; it is loaded when the first frame is asked for."""
    from service.products import pixels

    return pixels


@router.get("/frames")
def listing(service: Service, job_id: str) -> Response:
    """How many frames of which shape, tiles and layers; `watch`: a frame that can be looked at
    while others are drawn. 409 before anything is drawn."""
    product = _begun_product(service, job_id)
    about = frames.describe(product)
    return JSONResponse(about | {"watch": frames.frame_to_watch(product, about)})


@router.get("/frames/{frame}")
def one(service: Service, job_id: str, frame: Number) -> Response:
    """A frame: which of its tiles are drawn; once complete, its times and FITS WCS."""
    product = _begun_product(service, job_id)
    return JSONResponse(_pixels().frame_facts(product, frame))


BIN = (
    "pixels binned on each axis, to be looked at: each block is the mean of its mean and its "
    "maximum, so that faint stars stay visible (brighter than the mean where there is noise)"
)


class _Tile:
    """A tile of a layer of a job's frame, as a request names it."""

    def __init__(
        self,
        service: Service,
        job_id: str,
        frame: Number,
        row: Number,
        column: Number,
        layer: Annotated[str, Query(max_length=32)] = "dn",
        bin: Annotated[int, Query(ge=1, le=64, description=BIN)] = 1,
    ) -> None:
        self._service, self._job_id = service, job_id
        self._wanted = frame, row, column, layer, bin

    def values(self) -> Any:
        """Its values (rows, columns), binned."""
        product = _begun_product(self._service, self._job_id)
        return _pixels().tile_values(product, *self._wanted)


Tile = Annotated[_Tile, Depends()]


@router.get("/frames/{frame}/tiles/{row}/{column}")
def values(tile: Tile) -> Response:
    """A tile's values, little-endian, row by row; X-Shape and X-Type (numpy) tell of them."""
    with reading:
        found = tile.values()
        found = found.astype(found.dtype.newbyteorder("<"), copy=False)
        told = {"X-Shape": "{},{}".format(*found.shape), "X-Type": np.dtype(found.dtype).str}
        return Response(
            found.tobytes(), media_type="application/octet-stream", headers=FOR_GOOD | told
        )


@router.get("/frames/{frame}/tiles/{row}/{column}/picture.png")
def picture(
    tile: Tile,
    stretch: Literal["asinh", "linear", "log"] = "asinh",
    low: Annotated[float | None, Query(description="value drawn black")] = None,
    high: Annotated[float | None, Query(description="value drawn white")] = None,
) -> Response:
    """A tile as a picture, row 0 at the bottom; without `low` and `high`, by its percentiles."""
    with reading:
        png = _pixels().tile_picture(tile.values(), stretch, low, high)
    return Response(png, media_type="image/png", headers=FOR_GOOD)


@router.get("/frames/{frame}/truth")
def truth(
    service: Service,
    job_id: str,
    frame: Number,
    limit: Annotated[int, Query(ge=0, le=10_000, description="stars at most")] = 500,
) -> Response:
    """Targets and the brightest stars in a frame: places, names, light, signal-to-noise."""
    with reading:
        product = _whole_product(service, job_id)
        check_complete(product)
        return JSONResponse(_pixels().truth_of(product, frame, limit))


@router.get("/frames/{frame}/fits")
def fits(
    service: Service,
    job_id: str,
    frame: Number,
    layer: Annotated[str, Query(max_length=32)] = "dn",
) -> Response:
    """A frame as FITS, with WCS and times."""
    with reading:
        content = _pixels().frame_fits(_whole_product(service, job_id), frame, layer)
    name = f"{_file_name(service, job_id)}-{layer}-{frame:05d}.fits"
    return Response(content, media_type="application/fits", headers=_attachment(name))


@router.get("/record")
def record(
    service: Service,
    job_id: str,
    point: Annotated[
        int | None, Query(ge=0, lt=2**31, description="of a sweep: whose kept cube")
    ] = None,
) -> Response:
    """What the product was begun as; `.begun.json` of a fetched one, for `nightglass check`."""
    product = complete_product(service, job_id)
    path = (product if point is None else layout.cube_path(product, point)) / layout.BEGUN
    if not path.is_file():
        raise NotThere("the job keeps no such product")
    return Response(path.read_bytes(), media_type="application/json")


@router.get("/product.tar")
def product_tar(service: Service, job_id: str) -> Response:
    """The whole product as a tar, made as it is sent."""
    product = complete_product(service, job_id)
    name = _file_name(service, job_id)
    length, pieces = archive(product, name)
    headers = _attachment(f"{name}.tar") | {"Content-Length": str(length)}
    return StreamingResponse(pieces, media_type="application/x-tar", headers=headers)


def _file_name(service: Context, job_id: str) -> str:
    """A plain name for a job's files: its own name and the beginning of its id."""
    name = re.sub(r"[^A-Za-z0-9._-]+", "-", service.store.get(job_id).name).strip("-.") or "job"
    return f"{name[:60]}-{job_id[:8]}"


def _attachment(name: str) -> dict[str, str]:
    return {
        "Content-Disposition": f'attachment; filename="{name}"',
        "X-Content-Type-Options": "nosniff",
    }
