"""Make pins anew and say what changed: `python tests/pins/make.py [NAME...]` (`make pins`)."""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def main(names: list[str]) -> int:
    """Draw the named scenes (default: all), print what differs from their pins, keep them."""
    from tests.pins.compare import KEPT, kind_here, load, store
    from tests.pins.draw import draw
    from tests.pins.files import write_files
    from tests.pins.scenes import NAMES

    unknown = [name for name in names if name not in NAMES]
    if unknown:
        print(f"no such pin: {', '.join(unknown)}; known: {', '.join(NAMES)}", file=sys.stderr)
        return 2
    changed = 0
    with tempfile.TemporaryDirectory() as home:
        files = write_files(_made(Path(home) / "files"))
        for name in names or NAMES:
            started = time.perf_counter()
            drawn = draw(name, files, _made(Path(home) / name))
            pin = load(name) if (KEPT / f"{name}.json").is_file() else None
            said = _said(pin, drawn, kind_here())
            changed += said != []
            if said or pin is None or pin.kind != kind_here():
                store(name, drawn)
            took = time.perf_counter() - started
            print(f"{name}: {'; '.join(said) or 'as it was'} [{took:.2f} s]", flush=True)
    print(f"{changed} of {len(names or NAMES)} pins changed", flush=True)
    if not names:
        _forget({*NAMES})
    return 0


def _made(folder: Path) -> Path:
    folder.mkdir()
    return folder


def _said(pin, drawn, kind) -> list[str]:
    """What changed of a pin, the largest change in sigma first."""
    from tests.pins.compare import differences

    if pin is None:
        return ["new"]
    found = sorted(differences(pin, drawn, kind), key=lambda d: -d.sigma)
    return [str(d) for d in found[:6]] + ([f"and {len(found) - 6} more"] if found[6:] else [])


def _forget(names: set[str]) -> None:
    """Remove pins of scenes that are no more."""
    from tests.pins.compare import KEPT, KINDS

    for path in sorted(KEPT.iterdir()):
        if path.stem not in names and path.name != KINDS:
            path.unlink()
            print(f"{path.name}: removed")


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    sys.exit(main(sys.argv[1:]))
