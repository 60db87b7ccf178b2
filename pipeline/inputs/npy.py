"""NPY files of numbers: whole, or refused however they are cut off."""

from __future__ import annotations

from pathlib import Path
from tokenize import TokenError
from zipfile import BadZipFile

import numpy as np


def read_npy(path: Path, mapped: bool = False) -> np.ndarray:
    """The array of a file, or its bytes as they are asked for. ValueError for what is none."""
    try:
        array = np.load(path, mmap_mode="r" if mapped else None, allow_pickle=False)
    except (EOFError, MemoryError, SyntaxError, TokenError, BadZipFile) as error:
        raise ValueError(str(error)) from None
    if isinstance(array, np.ndarray):
        return array
    raise ValueError("it holds several arrays")
