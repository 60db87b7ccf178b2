"""The product on disk: Zarr cube, truth tables, markers, completeness."""
