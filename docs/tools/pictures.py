"""All pictures of the documentation, made by the product: `python docs/tools/pictures.py`."""

from __future__ import annotations

import argparse
import shutil
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

DOCS = Path(__file__).resolve().parents[1]
SIDE_PX = 900
PIECE_PX = 420
COLOURS = {1: (80, 255, 120), 2: (230, 120, 40)}


def main() -> None:
    """Render the demo (or take one that is there) and draw its pictures."""
    from pipeline.demo import run_demo
    from pipeline.studies.detection.study import report_detection

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--demo", type=Path, help="a demo's folder; default: make one")
    parser.add_argument("--docs", type=Path, default=DOCS)
    args = parser.parse_args()
    pictures = args.docs / "pictures"
    pictures.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as temporary:
        folder = args.demo or Path(temporary) / "demo"
        product = folder / "product" if args.demo else run_demo(folder, False, None, print)[0]
        draw_frame(product, pictures / "demo.jpg")
        draw_masks(product, Path(temporary) / "masks", pictures / "masks.png")
        study = Path(temporary) / "study"
        report_detection(product, study)
        shutil.copy(study / "detection.png", pictures / "detection.png")
        _, _, text = (study / "detection.md").read_text().partition(": ")
        text = text.replace("frame(s)", "frames", 1)
        head = "# Detection results\n\nFrom `nightglass report detection demo/product`: "
        (args.docs / "detection.md").write_text(head + text)


def draw_frame(product: Path, path: Path) -> None:
    """The first frame, targets marked."""
    from pipeline.export.picture import frame_picture

    frame_picture(product).resize((SIDE_PX, SIDE_PX)).save(path, quality=85)


def draw_masks(product: Path, folder: Path, path: Path) -> None:
    """A part of the first frame beside the classes of its mask."""
    from astropy.io import fits

    from pipeline.export.formats import ExportRequest, export_product
    from pipeline.export.picture import stretch
    from pipeline.store.cube import read_layer

    (mask,) = export_product(product, "masks", folder, ExportRequest(frame=0, stars_snr=20.0))
    with fits.open(mask) as hdus:
        classes, table = hdus["CLASS"].data, hdus["SOURCES"].data
    target = table[table["class"] == 1][0]
    y0, x0 = (max(0, int(target[a]) - PIECE_PX // 2) for a in "yx")
    cut = np.s_[y0 : y0 + PIECE_PX, x0 : x0 + PIECE_PX]
    grey = stretch(read_layer(product, "dn", 0))[cut][::-1]
    left = np.stack([grey] * 3, axis=-1)
    right = left // 3
    for kind, colour in COLOURS.items():
        right[classes[cut][::-1] == kind] = colour
    Image.fromarray(np.concatenate([left, right], axis=1)).save(path, optimize=True)


if __name__ == "__main__":
    main()
