"""Bearer tokens of an identity provider, verified with PyJWT against its published keys."""

from __future__ import annotations

import ipaddress
import json
import logging
import threading
import time
from pathlib import Path
from urllib.parse import urlsplit
from urllib.request import HTTPRedirectHandler, build_opener

import jwt

from catalog_tools.documents import JsonObject
from pipeline.errors import BadInput
from service.accounts.keys import TEAM
from service.problems import Forbidden, Unauthenticated

log = logging.getLogger("nightglass.service")
ALGORITHMS = ["RS256", "RS384", "RS512", "PS256", "PS384", "PS512", "ES256", "ES384", "EdDSA"]
LEEWAY_S = 30
READ_AGAIN_S, RENEW_S = 30.0, 3600.0  # an unknown key is looked for at most every half minute
MOST_BYTES = 1 << 20
INVALID = "the bearer token is not valid"


class Verifier:
    """Checks tokens: signature, issuer, audience, times; and says whose they are."""

    def __init__(self, issuer: str, audience: str, jwks: str, team_claim: str) -> None:
        self._issuer, self._audience, self._claim = issuer, audience, team_claim
        self._jwks = jwks
        self._keys: JsonObject = {}
        self._read_s = float("-inf")
        self._lock = threading.Lock()
        _check_place(jwks)

    def verify(self, token: str) -> tuple[str, str]:
        """(team, subject) of a token. Unauthenticated where it is not valid, Forbidden where it
        names no team. Nothing of the token is in the message."""
        try:
            kid = jwt.get_unverified_header(token).get("kid")
            key = self._key(kid)
            claims = jwt.decode(
                token,
                key,
                algorithms=ALGORITHMS,
                audience=self._audience,
                issuer=self._issuer,
                leeway=LEEWAY_S,
                options={"require": ["exp", "iss", "aud", "sub"]},
            )
        except jwt.ExpiredSignatureError:
            raise Unauthenticated("the bearer token has expired") from None
        except (jwt.PyJWTError, ValueError, TypeError):
            raise Unauthenticated(INVALID) from None
        team = claims.get(self._claim)
        if isinstance(team, list) and len(team) == 1:
            team = team[0]
        if not isinstance(team, str) or not TEAM.fullmatch(team):
            raise Forbidden(f"the token's claim {self._claim!r} must name one team")
        return team, f"oidc:{claims['sub']}"[:128]

    def _key(self, kid: object) -> jwt.PyJWK:
        with self._lock:
            age = time.monotonic() - self._read_s
            if age > (READ_AGAIN_S if kid not in self._keys else RENEW_S):
                self._read_s = time.monotonic()
                self._keys = _read_keys(self._jwks) or self._keys
            if kid not in self._keys:
                raise jwt.InvalidKeyError("unknown key")
            return self._keys[kid]


def _check_place(jwks: str) -> None:
    """A file, https, or http on this machine."""
    parts = urlsplit(jwks)
    if parts.scheme not in ("http", "https"):
        if not Path(jwks).is_file():
            raise BadInput("NIGHTGLASS_OIDC_JWKS", jwks, "an https URL, or a file that is there")
        return
    if parts.scheme == "http" and not _loopback(parts.hostname or ""):
        raise BadInput("NIGHTGLASS_OIDC_JWKS", jwks, "https beyond this machine")


def _loopback(host: str) -> bool:
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


class _NoRedirect(HTTPRedirectHandler):
    def redirect_request(self, *_: object) -> None:
        return None


def _read_keys(place: str) -> JsonObject | None:
    """Public signing keys by their ids; None where they cannot be read now."""
    try:
        if urlsplit(place).scheme in ("http", "https"):
            with build_opener(_NoRedirect).open(place, timeout=5) as answer:
                text = answer.read(MOST_BYTES)
        else:
            text = Path(place).read_bytes()
        found = jwt.PyJWKSet.from_dict(json.loads(text)).keys
    except (OSError, ValueError, TypeError, jwt.PyJWTError) as error:
        log.error("the identity provider's keys cannot be read: %s", type(error).__name__)
        return None
    return {
        key.key_id: key
        for key in found
        if key.algorithm_name in ALGORITHMS and key.key_id and key.public_key_use in (None, "sig")
    }
