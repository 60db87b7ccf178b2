"""Catalogues that a scene may name."""

from __future__ import annotations

from fastapi import APIRouter
from fastapi.responses import JSONResponse, Response

from service.context import Service
from service.scenes.catalogues import catalogue_facts, catalogue_names

router = APIRouter(prefix="/v1/catalogues", tags=["catalogues"])


@router.get("")
def listing(service: Service) -> Response:
    """The registered catalogues by name; `stars.catalogue` of a scene takes one of them."""
    registry = service.settings.catalogues
    facts = [catalogue_facts(registry, name) for name in catalogue_names(registry)]
    return JSONResponse({"catalogues": facts})
