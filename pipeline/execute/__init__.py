"""From the plan to finished tiles: pure rendering, and the Dask graph around it."""
