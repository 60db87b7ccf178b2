"""Catalogues of stars: read, partition, store, query; knows nothing of scenes or pixels."""

from catalog_tools.engine.home import ensure_home

ensure_home()
