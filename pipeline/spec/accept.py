"""What a scene accepts though it is not drawn as it would be seen: words, and what each allows."""

from __future__ import annotations

from typing import Literal, get_args

# One word for each doubt that stops a render; what it allows is said in ACCEPTABLE.
Accepted = Literal["error", "sun", "moon", "daylight", "coverage"]

ACCEPTABLE: dict[str, str] = {
    "error": "approximations whose bounds sum to more than accuracy.noise_fraction",
    "sun": "the Sun in the field or within the angle where its light would show; it is not drawn",
    "moon": "the Moon in the field; its disc is not drawn",
    "daylight": "a ground site where the Sun is too high for the night sky that is drawn",
    "coverage": "a field of which the catalogue covers nothing",
}
assert set(ACCEPTABLE) == set(get_args(Accepted))
