"""What came out of a peer's scene file: the scene, what was converted and what was lost."""

from __future__ import annotations

from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from catalog_tools.documents import JsonObject
from pipeline.errors import BadInput, check_new
from pipeline.spec.load import MAX_BYTES, parse_scene, scene_yaml
from pipeline.spec.scene import Scene
from pipeline.store.layout import write_atomically


@dataclass
class Notes:
    """Remarks gathered while a file is read.

    converted : what was given in other units or terms, with its new value
    assumed : what the file does not say, and a scene has to
    left_out : what could not be carried over
    """

    converted: list[str] = field(default_factory=list)
    assumed: list[str] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Imported:
    """A scene as plain data, the images that it names, and the notes.

    images : file name to array (rows, columns); they belong beside the scene file
    """

    source: str
    data: JsonObject
    images: dict[str, NDArray[np.float32]]
    notes: Notes

    def lines(self) -> list[str]:
        """The notes, one a line."""
        out = [f"from {self.source}"]
        for name, told in (
            ("converted", self.notes.converted),
            ("assumed", self.notes.assumed),
            ("not carried over", self.notes.left_out),
        ):
            out += [f"{name}: {one}" for one in told]
        return out

    def as_dict(self) -> JsonObject:
        """The notes as plain values."""
        return {
            "source": self.source,
            "converted": self.notes.converted,
            "assumed": self.notes.assumed,
            "not_carried_over": self.notes.left_out,
            "images": sorted(self.images),
        }

    def write(self, output: Path) -> Scene:
        """Write the scene with its notes as comments, and its images beside it; returns it."""
        for path in (output, *(output.parent / name for name in self.images)):
            check_new(path)
        scene = parse_scene(self.data)
        output.parent.mkdir(parents=True, exist_ok=True)
        for name, image in self.images.items():
            content = BytesIO()
            np.save(content, image, allow_pickle=False)
            write_atomically(output.parent / name, content.getvalue())
        head = "".join(f"# {line}\n" for line in self.lines())
        write_atomically(output, (head + scene_yaml(scene)).encode())
        return scene


def read_bytes(path: Path) -> bytes:
    """The bytes of a peer's file; BadInput for one that is not there or too large."""
    if not path.is_file():
        raise BadInput("FILE", str(path), "an existing scene file of the other simulator")
    if path.stat().st_size > MAX_BYTES:
        raise BadInput("FILE", str(path), f"a file of at most {MAX_BYTES} bytes")
    return path.read_bytes()


def scene_name(path: Path) -> str:
    """A valid scene name from a file's."""
    kept = "".join(c if c.isascii() and (c.isalnum() or c in "._-") else "-" for c in path.stem)
    return kept.lstrip("._-")[:120] or "imported"


class Fields:
    """A mapping of a peer's file, read by dotted key; every mistake names the key.

    What nobody asked for is what could not be carried over.
    """

    def __init__(self, data: object, where: str = "") -> None:
        if not isinstance(data, dict):
            raise BadInput(where or "FILE", data, "a mapping")
        self.data, self.where, self.used = data, where, set[str]()

    def has(self, key: str) -> bool:
        return self._find(key, False) is not None

    def get(self, key: str, default: object = None) -> Any:
        """A value, or the default where it is not given."""
        found = self._find(key, True)
        return default if found is None else found

    def number(self, key: str, low: float, high: float, default: float | None = None) -> float:
        """A finite number within bounds; BadInput otherwise, and where it is missing."""
        value = self.get(key, default)
        allowed = f"a number from {low:g} to {high:g}"
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise BadInput(self._name(key), value, allowed)
        if not low <= value <= high:
            raise BadInput(self._name(key), value, allowed)
        return float(value)

    def whole(self, key: str, low: int, high: int, default: int | None = None) -> int:
        """A whole number within bounds."""
        value = self.number(key, low, high, default)
        if value != int(value):
            raise BadInput(self._name(key), value, f"a whole number from {low} to {high}")
        return int(value)

    def pair(self, key: str, size: int = 2, high: float = 1e9) -> list[float]:
        """A list of so many finite numbers."""
        value = self.get(key)
        if not isinstance(value, list) or len(value) != size:
            raise BadInput(self._name(key), value, f"a list of {size} numbers")
        each = Fields({str(i): v for i, v in enumerate(value)}, self._name(key))
        return [each.number(str(i), -high, high) for i in range(size)]

    def unused(self) -> list[str]:
        """Dotted keys that were never asked for."""
        return [self._name(k) for k in _leaves(self.data, "") if not self._was_used(k)]

    def _was_used(self, key: str) -> bool:
        parts = key.split(".")
        return any(".".join(parts[: i + 1]) in self.used for i in range(len(parts)))

    def _find(self, key: str, use: bool) -> object:
        holder: object = self.data
        if use:
            self.used.add(key)
        for part in key.split("."):
            if not isinstance(holder, dict):
                return None
            holder = holder.get(part)
        return holder

    def _name(self, key: str) -> str:
        return f"{self.where}.{key}" if self.where else key


def _leaves(data: object, where: str) -> list[str]:
    if not isinstance(data, dict) or not data:
        return [where]
    before = f"{where}." * bool(where)
    return [leaf for k, v in data.items() for leaf in _leaves(v, f"{before}{k}")]
