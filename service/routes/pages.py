"""The web page: static files of the package, served under a strict Content-Security-Policy."""

from __future__ import annotations

import hashlib
from functools import cache
from importlib.resources import files

from fastapi import APIRouter, Request
from fastapi.responses import Response

from service.problems import NotThere
from service.products.files import is_known

router = APIRouter(include_in_schema=False)
TYPES = {
    "html": "text/html; charset=utf-8",
    "css": "text/css; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "svg": "image/svg+xml",
}
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; "
    "require-trusted-types-for 'script'; trusted-types 'none'"
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-cache",
}


@cache
def _contents() -> dict[str, tuple[bytes, str]]:
    """Content and ETag of every file of the page."""
    found = {}
    for entry in (files("service") / "page").iterdir():
        if entry.name.rpartition(".")[2] in TYPES:
            content = entry.read_bytes()
            found[entry.name] = content, f'"{hashlib.sha256(content).hexdigest()[:32]}"'
    return found


@router.head("/")
@router.get("/")
def front(request: Request) -> Response:
    """The page."""
    return part(request, "index.html")


@router.head("/page/{name}")
@router.get("/page/{name}")
def part(request: Request, name: str) -> Response:
    """A file of the page."""
    if name not in _contents():
        raise NotThere("there is no such file of the page")
    content, tag = _contents()[name]
    headers = HEADERS | {"ETag": tag}
    if is_known(request.headers.get("if-none-match"), tag):
        return Response(status_code=304, headers=headers)
    return Response(content, media_type=TYPES[name.rpartition(".")[2]], headers=headers)
