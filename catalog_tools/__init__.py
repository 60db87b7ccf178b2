"""Catalogues of stars: read, partition, store, query; knows nothing of scenes or pixels."""
