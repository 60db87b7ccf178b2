"""From a scene to a product: plan, inputs, Dask graph, Zarr cube, truth, report."""
