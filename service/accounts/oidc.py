"""Bearer tokens of an identity provider, verified with PyJWT against its published keys."""

from __future__ import annotations

import ipaddress
import json
import logging
import threading
import time
from http.client import HTTPException
from pathlib import Path
from urllib.parse import urlsplit
from urllib.request import HTTPRedirectHandler, build_opener

import jwt

from pipeline.errors import BadInput
from service.accounts.keys import TEAM
from service.problems import Forbidden, NoProvider, Unauthenticated

log = logging.getLogger("nightglass.service")
ALGORITHMS = ["RS256", "RS384", "RS512", "PS256", "PS384", "PS512", "ES256", "ES384", "EdDSA"]
LEEWAY_S = 30
READ_AGAIN_S, RENEW_S = 30.0, 3600.0  # an unknown key is looked for at most every half minute
MOST_BYTES = 1 << 20
Keys = dict[str | None, jwt.PyJWK]
INVALID = "the bearer token is not valid"
REASONS: tuple[tuple[type[Exception], str], ...] = (  # all found after the signature
    (jwt.ExpiredSignatureError, "the bearer token has expired"),
    (jwt.ImmatureSignatureError, "the bearer token is not valid yet"),
    (jwt.InvalidIssuerError, "the bearer token is of another issuer"),
    (jwt.InvalidAudienceError, "the bearer token is for another audience"),
)


class Verifier:
    """Checks tokens: signature, issuer, audience, times; and says whose they are."""

    def __init__(self, issuer: str, audience: str, jwks: str, team_claim: str) -> None:
        self._issuer, self._audience, self._claim = issuer, audience, team_claim
        self._jwks = jwks
        self._keys: Keys = {}
        self._read_s, self._reached = float("-inf"), True
        self._lock = threading.Lock()
        check_place(jwks)

    def verify(self, token: str) -> tuple[str, str]:
        """(team, subject) of a token. Unauthenticated where it is not valid, Forbidden where it
        names no team, NoProvider where the keys cannot be read. Nothing of the token is in the
        message."""
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
        except (jwt.PyJWTError, ValueError, TypeError) as error:
            told = next((text for kind, text in REASONS if isinstance(error, kind)), INVALID)
            raise Unauthenticated(told) from None
        if not claims["sub"] or not claims["sub"].isprintable():  # it goes into the job table
            raise Unauthenticated("the token's claim 'sub' must be printable text")
        team = claims.get(self._claim)
        if isinstance(team, list) and len(team) == 1:
            team = team[0]
        if not isinstance(team, str) or not TEAM.fullmatch(team):
            raise Forbidden(f"the token's claim {self._claim!r} must name one team")
        return team, f"oidc:{claims['sub']}"[:128]

    def _key(self, kid: str | None) -> jwt.PyJWK:
        with self._lock:
            age = time.monotonic() - self._read_s
            # without an id only the signature would tell that there is a new key
            if age > (RENEW_S if kid is not None and kid in self._keys else READ_AGAIN_S):
                self._read_s = time.monotonic()
                found = _read_keys(self._jwks)
                self._reached = found is not None
                self._keys = found or self._keys
            if kid not in self._keys:
                if not self._reached:
                    raise NoProvider("the identity provider's keys cannot be read now; try again")
                raise jwt.InvalidKeyError("unknown key")
            return self._keys[kid]


def check_place(jwks: str) -> None:
    """A file, https, or http on this machine; BadInput for anything else."""
    allowed = "an https URL, or a file that is there"
    try:
        parts = urlsplit(jwks)
        known = bool(parts.hostname) and parts.port != 0
    except ValueError:
        raise BadInput("NIGHTGLASS_OIDC_JWKS", jwks, allowed) from None
    if parts.scheme not in ("http", "https"):
        known = Path(jwks).is_file()
    if not known:
        raise BadInput("NIGHTGLASS_OIDC_JWKS", jwks, allowed)
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


def _read_keys(place: str) -> Keys | None:
    """Public signing keys by their ids, the only one also by None: its tokens need name no key
    (OpenID Connect Core, 10.1). None where they cannot be read now."""
    try:
        if urlsplit(place).scheme in ("http", "https"):
            with build_opener(_NoRedirect).open(place, timeout=5) as answer:
                text = answer.read(MOST_BYTES)
        else:
            text = Path(place).read_bytes()
        found = [
            key
            for key in jwt.PyJWKSet.from_dict(dict(json.loads(text))).keys
            if key.algorithm_name in ALGORITHMS and key.public_key_use in (None, "sig")
        ]
        keys: Keys = {key.key_id: key for key in found if key.key_id}
    except (OSError, HTTPException, ValueError, TypeError, RecursionError, jwt.PyJWTError) as error:
        log.error("the identity provider's keys cannot be read: %s", type(error).__name__)
        return None
    return keys | {None: found[0]} if len(found) == 1 else keys
