"""Pins on disk, and what differs: to the bit on their kind of processor, elsewhere by value."""

from __future__ import annotations

import hashlib
import json
import lzma
import platform
import sys
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from tests.pins.draw import Drawn

KEPT = Path(__file__).parent / "kept"
KINDS = "kinds.json"  # of processors, by the names that pins use
PACKAGES = ("numpy", "numba", "llvmlite", "scipy", "pyerfa", "sgp4")
MEAN_SIGMA = 1e-6  # of a pixel's noise: on another kind, of means before noise is drawn
ROWS = 12  # kept of a table of the truth: the digest is of all
DN_STEP, DN_SHARE = 1, 1e-4  # likewise of what was drawn: by so much, in so many of the pixels
RELATIVE, PLACE_PX, ANGLE_DEG = 1e-6, 1e-6, 1e-9  # likewise of the truth, the plan, the rest
ROUNDING = 1e-12  # of numbers of the plan that are differences of larger ones


@dataclass(frozen=True)
class Difference:
    """One array or number that differs; sigma : of light, by how much of a pixel's noise."""

    name: str
    how: str
    sigma: float = 0.0

    def __str__(self) -> str:
        return f"{self.name}: {self.how}" + (f" ({self.sigma:.3g} sigma)" if self.sigma else "")


@dataclass(frozen=True)
class Pin:
    """A stored pin: what was drawn, the kind of processor that drew it, and digests of it.

    digests : by group of arrays; rows : of each table of the truth, of which `drawn` holds some
    """

    kind: dict[str, str]
    digests: dict[str, str]
    drawn: Drawn
    rows: dict[str, int]


def kind_here() -> dict[str, str]:
    """The kind of this processor: its name, the extensions that numpy and LLVM see, versions."""
    import llvmlite.binding as llvm
    from numpy._core._multiarray_umath import __cpu_features__

    llvm_features = llvm.get_host_cpu_features()
    return {
        "processor": _processor(),
        "machine": f"{platform.machine()}, {sys.byteorder} endian",
        "numpy_extensions": " ".join(sorted(k for k, v in __cpu_features__.items() if v)),
        "llvm_processor": llvm.get_host_cpu_name(),
        "llvm_extensions": " ".join(sorted(k for k, v in llvm_features.items() if v)),
        "python": platform.python_version(),
    } | {name: version(name) for name in PACKAGES}


def _processor() -> str:
    """The processor's name as the system tells it."""
    info = Path("/proc/cpuinfo")
    for line in info.read_text().splitlines() if info.is_file() else ():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.processor()


def digests_of(drawn: Drawn) -> dict[str, str]:
    """A short SHA-256 of each group of arrays, and one of the plan's numbers."""
    sums: dict[str, Any] = {}
    for name, value in sorted(drawn.arrays.items()):
        told = f"{name} {value.dtype.str} {value.shape}".encode()
        found = sums.setdefault(group_of(name), hashlib.sha256())
        found.update(told + np.ascontiguousarray(value).tobytes())
    plan = hashlib.sha256(json.dumps(drawn.plan, sort_keys=True).encode())
    return {name: found.hexdigest()[:16] for name, found in (sums | {"plan": plan}).items()}


def group_of(name: str) -> str:
    """What an array is digested with: a layer by itself, a table, the coordinates, a file."""
    first, second = name.split("/")[:2]
    layer = first != "cube" or second == "dn" or second.endswith("_e")
    return f"{first}/{second}" if layer else "cube/coordinates"


def store(name: str, drawn: Drawn, folder: Path = KEPT) -> None:
    """Keep what was drawn as the pin of a scene: NAME.json (digests) and NAME.xz (values)."""
    kind = kind_here()
    called = hashlib.sha256(json.dumps(kind, sort_keys=True).encode()).hexdigest()[:8]
    folder.mkdir(parents=True, exist_ok=True)
    _write(folder / KINDS, _kinds(folder) | {called: kind})
    told = {"kind": called, "rows": rows_of(drawn), "digests": digests_of(drawn)}
    _write(folder / f"{name}.json", told)
    (folder / f"{name}.xz").write_bytes(packed(drawn))


def _write(path: Path, data: dict[str, Any]) -> None:
    path.write_text(json.dumps(data, indent=1) + "\n")


def _kinds(folder: Path) -> dict[str, dict[str, str]]:
    path = folder / KINDS
    return json.loads(path.read_text()) if path.is_file() else {}


def packed(drawn: Drawn) -> bytes:
    """What is drawn, as one line of JSON and the arrays' bytes, compressed; no bit is lost.

    The bytes of numbers are sorted by significance: exponents lie together and shrink.
    """
    kept = {name: thinned(name, value) for name, value in sorted(drawn.arrays.items())}
    head = {
        "sigma_e": drawn.sigma_e, "gain_e_per_dn": drawn.gain_e_per_dn, "plan": drawn.plan,
        "arrays": [[name, v.dtype.str, v.shape] for name, v in kept.items()],
    }  # fmt: skip
    parts = [json.dumps(head).encode() + b"\n"]
    for value in kept.values():
        flat = np.frombuffer(np.ascontiguousarray(value).tobytes(), np.uint8)
        parts.append(flat.reshape(value.size, value.dtype.itemsize).T.tobytes())
    return lzma.compress(b"".join(parts), preset=9)


def unpacked(content: bytes) -> Drawn:
    """What `packed` was made of."""
    line, _, rest = lzma.decompress(content).partition(b"\n")
    head, arrays, at = json.loads(line), {}, 0
    for name, type_, shape in head["arrays"]:
        kind, count = np.dtype(type_), int(np.prod(shape, dtype=np.int64))
        flat = np.frombuffer(rest, np.uint8, count * kind.itemsize, at)
        at += flat.size
        flat = np.ascontiguousarray(flat.reshape(kind.itemsize, count).T)
        arrays[name] = flat.view(kind).reshape(shape) if count else np.empty(shape, kind)
    return Drawn(arrays, head["plan"], head["sigma_e"], head["gain_e_per_dn"])


def rows_of(drawn: Drawn) -> dict[str, int]:
    """How many rows each table of the truth has."""
    tables = {name.split("/")[1]: v for name, v in drawn.arrays.items() if "truth/" in name}
    return {name: len(column) for name, column in tables.items()}


def thinned(name: str, value: np.ndarray) -> np.ndarray:
    """What a pin keeps of an array: all of it; of a long table of the truth some ROWS rows."""
    if not name.startswith("truth/") or len(value) <= ROWS:
        return value
    return value[np.linspace(0, len(value) - 1, ROWS).astype(int)]


def load(name: str, folder: Path = KEPT) -> Pin:
    """The pin of a scene."""
    told = json.loads((folder / f"{name}.json").read_text())
    drawn = unpacked((folder / f"{name}.xz").read_bytes())
    return Pin(_kinds(folder)[told["kind"]], told["digests"], drawn, told["rows"])


def differences(pin: Pin, found: Drawn, kind: dict[str, str]) -> list[Difference]:
    """What of a drawn scene is not as it is pinned.

    On the pin's own kind of processor: every array whose bits differ. On any other: what differs by
    more than the tolerances of this module.
    """
    same = pin.kind == kind
    told = digests_of(found)
    if same and told == pin.digests:
        return []
    rows = _paired(pin.rows, rows_of(found))
    out = [Difference(f"truth/{k}", f"{a} rows became {b}") for k, a, b in rows if a != b]
    for name, a, b in _paired(pin.drawn.arrays, found.arrays):
        if a is None or b is None:
            out.append(_unpaired(name, a, b))
        else:
            out += difference(name, a, thinned(name, b), pin.drawn, exactly=same)
    out += _of_plan(pin.drawn.plan, found.plan, exactly=same)
    groups = _paired(pin.digests, told) if same and not out else []
    return out + [Difference(name, "differs in rows that are not kept")
                  for name, a, b in groups if a != b]  # fmt: skip


def _paired(a: dict[str, Any], b: dict[str, Any]) -> list[tuple[str, Any, Any]]:
    return [(name, a.get(name), b.get(name)) for name in sorted(a.keys() | b.keys())]


def _unpaired(name: str, pinned: Any, found: Any) -> Difference:
    return Difference(name, "is new" if pinned is None else "is gone")


def difference(
    name: str, pinned: np.ndarray, found: np.ndarray, of: Drawn, exactly: bool
) -> list[Difference]:
    """How an array differs: one entry, or none where it is within the tolerances.

    exactly : any bit counts
    """
    if pinned.shape != found.shape or pinned.dtype != found.dtype:
        how = f"{pinned.dtype}{pinned.shape} became {found.dtype}{found.shape}"
        return [Difference(name, how)]
    if pinned.dtype.kind in "US?":
        count = int((pinned != found).sum())
        return [Difference(name, f"{count} of {pinned.size} differ")] if count else []
    off = _off(pinned, found)
    if exactly and pinned.tobytes() == found.tobytes():
        return []
    allowed = np.zeros(off.shape) if exactly else _allowed(name, pinned, of)
    beyond = off > allowed
    few = 0 if exactly or not _is_drawn(name, pinned) else DN_SHARE * off.size
    largest = max(DN_STEP, float(allowed.max(initial=0.0)))
    if not exactly and beyond.sum() <= few and (not few or off.max(initial=0.0) <= largest):
        return []
    how = f"{int(beyond.sum())} of {off.size} differ, by up to {off.max(initial=0.0):.6g}"
    return [Difference(name, how, _in_sigma(name, pinned, off, of))]


def _off(pinned: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Absolute differences; NaN equals NaN; whole numbers to the last digit."""
    if pinned.dtype.kind in "iu":
        high, low = np.maximum(pinned, found), np.minimum(pinned, found)
        return (high - low).astype(np.float64)
    a, b = pinned.astype(np.float64), found.astype(np.float64)
    with np.errstate(invalid="ignore"):
        off = np.abs(a - b)
    off[(a == b) | (np.isnan(a) & np.isnan(b))] = 0.0
    return np.where(np.isnan(off), np.inf, off)


def _is_drawn(name: str, value: np.ndarray) -> bool:
    """Whether an array holds pixels after noise was drawn, or what is made from such."""
    last = name.rsplit("/", 1)[-1]
    return last in ("dn", "calibrated_e", "pixels", "data", "CLASS", "SOURCE")


def _is_light(name: str) -> bool:
    """Whether an array is a noise-free layer of a cube."""
    return name.startswith("cube/") and name.endswith("_e") and not name.endswith("calibrated_e")


def _noise_e(pinned: np.ndarray, of: Drawn) -> np.ndarray:
    """Noise of each pixel of a noise-free layer [e-], at least (within a factor 1.4)."""
    return np.sqrt(np.maximum(of.sigma_e**2, pinned.astype(np.float64)))


def _allowed(name: str, pinned: np.ndarray, of: Drawn) -> np.ndarray:
    """What an array may differ by on another kind of processor."""
    if _is_light(name):  # stored in float32: another last bit is no other light
        ulp = np.spacing(np.abs(pinned)).astype(np.float64)
        return MEAN_SIGMA * _noise_e(pinned, of) + ulp
    if _is_drawn(name, pinned):
        scale = 1.0 if pinned.dtype.kind == "f" else of.gain_e_per_dn
        return np.full(pinned.shape, MEAN_SIGMA * of.sigma_e / scale)
    if pinned.dtype.kind in "iu":
        return np.zeros(pinned.shape)
    floor = PLACE_PX if name.endswith("_px") else ANGLE_DEG
    relative = 0.0 if name.endswith(("_px", "_deg")) else RELATIVE
    with np.errstate(invalid="ignore"):
        return np.nan_to_num(floor + relative * np.abs(pinned.astype(np.float64)))


def _in_sigma(name: str, pinned: np.ndarray, off: np.ndarray, of: Drawn) -> float:
    """The largest difference in units of a pixel's noise; 0 for what is no light."""
    if not off.size:
        return 0.0
    if _is_light(name):
        return float((off / _noise_e(pinned, of)).max())
    if name.endswith("/dn"):
        return float(off.max()) * of.gain_e_per_dn / of.sigma_e
    return 0.0


def _of_plan(pinned: dict[str, Any], found: dict[str, Any], exactly: bool) -> list[Difference]:
    out = []
    for key, a, b in _paired(pinned, found):
        if a is None or b is None:
            out.append(_unpaired(f"plan {key}", a, b))
        elif a != b and (exactly or not _near(a, b)):
            out.append(Difference(f"plan {key}", f"{a!r} became {b!r}"))
    return out


def _near(a: Any, b: Any) -> bool:
    """Whether two numbers of a plan agree; whole ones and yes or no must be the same."""
    if isinstance(a, bool) or isinstance(b, bool) or (isinstance(a, int) and isinstance(b, int)):
        return a == b
    return abs(a - b) <= RELATIVE * max(abs(a), abs(b)) + ROUNDING
