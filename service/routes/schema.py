"""The JSON Schema of the scene format."""

from __future__ import annotations

from fastapi import APIRouter
from fastapi.responses import JSONResponse, Response

from pipeline.spec.scene import Scene
from service.context import Service

router = APIRouter(prefix="/v1/schema", tags=["schema"])


@router.get("/scene")
def scene(_: Service) -> Response:
    """JSON Schema (2020-12) of a scene, as `nightglass schema` prints it."""
    return JSONResponse(
        Scene.model_json_schema(by_alias=True), media_type="application/schema+json"
    )
