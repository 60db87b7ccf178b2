"""Query parameters of an address: those that its route takes, and no others."""

from __future__ import annotations

from fastapi import Request
from fastapi.dependencies.models import Dependant

from pipeline.errors import BadInput
from service.context import Service

TICKET = "ticket"  # stands for a key in the address of a download


async def only_known(request: Request, _: Service) -> None:
    """BadInput for a parameter that the matched route does not take, after the caller is known."""
    taken = _names(request.scope["route"].dependant)
    may_have_ticket = request.method in ("GET", "HEAD")
    for name, value in request.query_params.multi_items():
        if name not in taken and not (may_have_ticket and name == TICKET):
            raise BadInput(f"?{name}", value, ", ".join(taken) or "no parameter at this address")


def _names(dependant: Dependant) -> list[str]:
    """Query parameters of a route and of what it depends on, each once."""
    names = [one.alias for one in dependant.query_params]
    names += [name for other in dependant.dependencies for name in _names(other)]
    return list(dict.fromkeys(names))
